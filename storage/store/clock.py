"""Whether the clock can be trusted to remove what is too old, which nothing brings back."""

import json
import logging
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from storage.errors import StorageError
from storage.files.files import publish

_DAY_S = 86_400.0

_log = logging.getLogger("tensormap.storage")


class ClockWatch:
    """Detects that the clock was set, while a service runs or while it was stopped.

    A machine without a battery starts in 1970, until it has the time from its network: what is
    deleted then seems to be ancient an hour later. So after a jump of more than a day nothing is
    removed until services have run for a day, in which an administrator can restore it. A service
    that was stopped for more than a day waits likewise: the file shows no difference.

    Args:
        path: Holds the time at which a watch last looked, and how long it waits; it may not exist.
        wall: Returns the seconds since 1970.
        monotonic: Returns seconds that go on whatever is set.
    """

    def __init__(
        self,
        path: Path,
        *,
        wall: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path = path
        self._wall, self._monotonic = wall, monotonic
        self._seen: tuple[float, float] | None = None  # both clocks, when it last looked
        self._waits_s = 0.0

    def is_trusted(self) -> bool:
        """Return whether the clock did not jump, or has gone on steadily for a day since."""
        now_s, ticks_s = self._wall(), self._monotonic()
        if self._seen is None:
            saved_s, self._waits_s = self._read(now_s)
            ahead_s, passed_s = now_s - saved_s, 0.0
        else:
            passed_s = ticks_s - self._seen[1]
            ahead_s = now_s - self._seen[0] - passed_s
        self._waits_s = max(self._waits_s - passed_s, 0.0)
        if abs(ahead_s) > _DAY_S:
            self._waits_s = _DAY_S
            _log.warning(
                "the clock is at %s and was expected at %s: until the service has run for a day"
                " nothing is removed for its age, as the clock may be wrong",
                _shown(now_s),
                _shown(now_s - ahead_s),
            )
        self._seen = (now_s, ticks_s)
        self._save(now_s)
        return not self._waits_s

    def _read(self, now_s: float) -> tuple[float, float]:
        """Return what was saved; without that the present, and no time to wait."""
        try:
            saved = json.loads(self._path.read_text())
            return float(saved["at_s"]), float(saved["waits_s"])
        except FileNotFoundError:
            pass
        except (OSError, ValueError, KeyError, TypeError) as error:
            _log.warning("%s cannot be read, it is made again: %s", self._path, error)
        return now_s, 0.0

    def _save(self, now_s: float) -> None:
        try:
            with publish(self._path) as part:
                part.write_text(json.dumps({"at_s": now_s, "waits_s": self._waits_s}) + "\n")
        except (StorageError, OSError) as error:  # on a full disk removing goes on
            _log.warning("%s cannot be written: %s", self._path, error)


def _shown(at_s: float) -> str:
    return f"{datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=at_s):%Y-%m-%d %H:%M}Z"
