"""A job is followed to its end."""

from collections.abc import Mapping
from typing import Any

import pytest
from tensormap_client._sync import builds
from tensormap_client._sync.builds import follow


class Jobs:
    """A service whose job is a little further each time."""

    def __init__(self, *jobs: Mapping[str, Any]) -> None:
        self.jobs = list(jobs)

    def json(self, method: str, path: str) -> Mapping[str, Any]:
        assert (method, path) == ("GET", "/v1/jobs/j")
        return self.jobs.pop(0)


class Written:
    """A progress that records its calls."""

    def __init__(self) -> None:
        self.lines: list[tuple[str | int, ...]] = []

    def start(self, stage: str, total: int) -> None:
        self.lines.append((stage, total))

    def advance(self, units: int = 1) -> None:
        raise AssertionError

    def move_to(self, done: int) -> None:
        self.lines.append((done,))

    def sent(self, size_bytes: int) -> None:
        raise AssertionError


def job(state: str, stage: str | None, done: int, total: int) -> Mapping[str, Any]:
    return {"job": "j", "state": state, "stage": stage, "done": done, "total": total}


def test_a_job_that_waits_leaves_the_progress_of_the_upload_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(builds, "sleep", lambda _: None)
    queued, written = job("queued", None, 0, 0), Written()
    service: Any = Jobs(
        queued, job("running", "projecting", 3, 9), done := job("done", "calibrating", 2, 2)
    )
    assert follow(service, queued, written) == done
    assert written.lines == [("projecting", 9), (3,), ("calibrating", 2), (2,)]
