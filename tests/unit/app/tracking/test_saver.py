"""Tracks are saved once a second, and what hinders that is logged once."""

import logging
import threading

import pytest

from app.tracking.saver import TrackSaver
from storage.errors import StorageFull, StorageUnavailable

FULL, BROKEN = StorageFull("no space is left"), StorageUnavailable("the disk fails")


class Tracks:
    """Fails to save with each of some errors in turn, `None` for a success, then is done."""

    def __init__(self, *outcomes: Exception | None) -> None:
        self.outcomes, self.done = list(outcomes), threading.Event()

    def save(self) -> None:
        if not self.outcomes:
            self.done.set()
        elif error := self.outcomes.pop(0):
            raise error


def test_a_disk_that_stays_full_is_logged_once_and_again_after_it_had_room(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("app.tracking.saver._EVERY_S", 0.001)
    caplog.set_level(logging.INFO, "tensormap.tracks")
    tracks = Tracks(FULL, FULL, FULL, BROKEN, BROKEN, None, None, FULL)
    saver = TrackSaver(tracks)  # type: ignore[arg-type]
    saver.start()
    assert tracks.done.wait(20.0)
    saver.stop()
    logged = [(record.levelname, record.getMessage()) for record in caplog.records]
    assert logged == [
        ("ERROR", "the tracks cannot be saved: no space is left"),
        ("ERROR", "the tracks cannot be saved: the disk fails"),
        ("INFO", "this is over: the tracks cannot be saved"),
        ("ERROR", "the tracks cannot be saved: no space is left"),
        ("INFO", "this is over: the tracks cannot be saved"),
    ]
