"""Saves the tracks that changed, once a second, and all when the service stops."""

import logging
import threading

from app.ending import end
from app.outage import Outage
from app.tracking.tracks import Tracks

_EVERY_S = 1.0  # what a killed process loses; fifty vehicles at 10 Hz are one commit a second then

_log = logging.getLogger("tensormap.tracks")


class TrackSaver:
    """Saves tracks in a thread of its own; observations never wait for a commit.

    Args:
        tracks: The service's tracks.
    """

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="track saver", daemon=True)

    def start(self) -> None:
        """Start saving."""
        self._thread.start()

    def stop(self) -> None:
        """Save what changed since, unless the disk hangs, and stop."""
        self._stopping.set()
        end(self._thread)

    def _loop(self) -> None:
        last, outage = False, Outage(_log, "the tracks cannot be saved")
        while not last:
            last = self._stopping.wait(_EVERY_S)
            try:
                self._tracks.save()
            except Exception as error:  # noqa: BLE001 - the next attempt saves what this one did not
                outage.failed(error)
            else:
                outage.over()
