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


@pytest.mark.parametrize("total", [9, 12])
def test_a_stage_that_begins_again_with_the_next_drive_is_counted_anew(
    monkeypatch: pytest.MonkeyPatch, total: int
) -> None:
    monkeypatch.setattr(builds, "sleep", lambda _: None)
    first, written = job("running", "projecting", 7, 9), Written()
    service: Any = Jobs(
        job("running", "projecting", 8, 9),
        job("running", "projecting", 2, total),
        done := job("done", "projecting", total, total),
    )
    assert follow(service, first, written) == done
    assert written.lines == [
        ("projecting", 9), (7,), (8,), ("projecting", total), (2,), (total,),
    ]  # fmt: skip


def test_a_larger_drive_is_counted_to_its_own_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(builds, "sleep", lambda _: None)
    first, written = job("running", "projecting", 2, 4), Written()
    service: Any = Jobs(done := job("done", "projecting", 9, 9))
    assert follow(service, first, written) == done
    assert written.lines == [("projecting", 4), (2,), ("projecting", 9), (9,)]
