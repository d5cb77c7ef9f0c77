"""The stop of a service does not wait for what hangs."""

import logging
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from app import ending
from app.collector import GarbageCollector
from app.localization.place_indexes import PlaceIndexes
from app.settings import Settings
from app.tracking.saver import TrackSaver

ROOT = Path(__file__).parents[3]


class _Hung:
    """A store and tracks of which nothing returns until it is released."""

    def __init__(self) -> None:
        self.reached, self.released = threading.Event(), threading.Event()

    def hang(self, *_: object) -> bool:
        self.reached.set()
        self.released.wait(60.0)
        return False


def _collector(hung: _Hung) -> Any:
    store = SimpleNamespace(
        clock=SimpleNamespace(is_trusted=hung.hang), purges=SimpleNamespace(finish_all=lambda: None)
    )
    return GarbageCollector(Settings(), store)  # type: ignore[arg-type]


def _saver(hung: _Hung) -> Any:
    return TrackSaver(SimpleNamespace(save=hung.hang))  # type: ignore[arg-type]


@pytest.mark.parametrize(("make", "name"), [(_collector, "collector"), (_saver, "track saver")])
def test_a_part_that_hangs_is_logged_and_left_to_the_end_of_the_process(
    make: Callable[[_Hung], Any],
    name: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("app.ending.THREADS_S", 0.05)
    hung = _Hung()
    part = make(hung)
    part.start()
    assert hung.reached.wait(20.0)
    stopping = threading.Thread(target=part.stop, daemon=True)
    stopping.start()
    stopping.join(20.0)
    ended = not stopping.is_alive()
    hung.released.set()
    stopping.join(20.0)
    assert ended
    # Of the end alone: what was released goes on, and may log that its store is none.
    said = [record.getMessage() for record in caplog.records if record.name == "tensormap.stop"]
    assert said == [f"the {name} did not end within 0.05 s: the process ends it"]


def test_a_part_that_was_not_started_is_stopped_at_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    indexes = PlaceIndexes(SimpleNamespace())  # type: ignore[arg-type]
    indexes.stop()
    _saver(_Hung()).stop()
    assert not caplog.records


def test_what_hangs_or_fails_is_logged_and_the_others_are_closed(
    caplog: pytest.LogCaptureFixture,
) -> None:
    hung, closed = _Hung(), threading.Event()

    def fail() -> None:
        raise OSError("no such disk")

    begun_s = time.monotonic()
    calls: dict[str, Callable[[], object]] = {
        "the tracks": hung.hang,
        "the scrub": fail,
        "the store": closed.set,
    }
    ending.call_all(calls, 0.2)
    took_s = time.monotonic() - begun_s
    hung.released.set()
    assert closed.is_set()
    assert took_s < 20.0
    assert {record.getMessage() for record in caplog.records} == {
        "the tracks did not end within 0.2 s: the process ends it",
        "the scrub cannot be stopped",
    }


def test_where_no_thread_can_be_started_all_are_stopped_in_turn(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    def fail() -> None:
        raise OSError("no such disk")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    closed = threading.Event()
    ending.call_all({"the scrub": fail, "the store": closed.set}, 1.0)
    assert closed.is_set()
    assert [record.getMessage() for record in caplog.records] == ["the scrub cannot be stopped"]


def test_a_stop_ends_before_the_files_of_the_deployment_have_it_killed() -> None:
    longest_s = ending.ANSWERS_S + ending.PARTS_S + ending.CLOSING_S + ending.LAST_S
    assert ending.THREADS_S < ending.PARTS_S  # so that each thread is named
    assert ending.KILLED_S < ending.THREADS_S  # so that the job of a killed process is queued again
    compose = (ROOT / "compose.yaml").read_text()
    unit = (ROOT / "deploy" / "tensormap.service").read_text()
    found = re.findall(r"^ *(?:stop_grace_period: |TimeoutStopSec=)(\d+)", compose + unit, re.M)
    allowed_s = [int(seconds) for seconds in found]
    assert len(allowed_s) == 2
    assert longest_s + 1.0 <= min(allowed_s)  # a second for the process itself
