"""The stop of a service does not wait for a thread whose disk hangs."""

import logging
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from app.collector import GarbageCollector
from app.localization.place_indexes import PlaceIndexes
from app.settings import Settings
from app.tracking.saver import TrackSaver


class _Hung:
    """A store and tracks of which nothing returns until it is released."""

    def __init__(self) -> None:
        self.reached, self.released = threading.Event(), threading.Event()

    def hang(self, *_: object) -> bool:
        self.reached.set()
        self.released.wait(60.0)
        return False


def _collector(hung: _Hung) -> Any:
    store = SimpleNamespace(clock=SimpleNamespace(is_trusted=hung.hang))
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
    monkeypatch.setattr("app.ending.LONGEST_S", 0.05)
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
    assert [record.getMessage() for record in caplog.records] == [
        f"the {name} did not end within 0.05 s: the process ends it"
    ]


def test_a_part_that_was_not_started_is_stopped_at_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    indexes = PlaceIndexes(SimpleNamespace())  # type: ignore[arg-type]
    indexes.stop()
    _saver(_Hung()).stop()
    assert not caplog.records
