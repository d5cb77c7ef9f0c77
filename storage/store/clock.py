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

_DAMAGE = (ValueError, KeyError, TypeError, OverflowError, RecursionError)

_log = logging.getLogger("tensormap.storage")


class ClockWatch:
    """Detects that the clock was set, while a service runs or while it was stopped.

    A machine without a battery starts in 1970, until it has the time from its network: what is
    deleted then seems to be ancient an hour later. So after a jump of more than a day nothing is
    removed until services have run for a day, in which an administrator can restore it. A service
    that was stopped for more than a day waits likewise: the file shows no difference. If it is
    stopped so again, as on a vehicle that is used each weekend, what is left of the wait stays:
    else it would never end. Any other jump starts it again.

    Args:
        path: Holds the time of the last check, and what is left of a wait; it may not exist.
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
        self._by_stop = False  # whether it waits for what may have been only a stop

    def is_trusted(self) -> bool:
        """Return whether the clock did not jump, or services have run for a day since."""
        now_s, ticks_s = self._wall(), self._monotonic()
        starts = self._seen is None
        if self._seen is None:
            saved_s = self._read(now_s)
            ahead_s, passed_s = now_s - saved_s, 0.0
        else:
            passed_s = ticks_s - self._seen[1]
            ahead_s = now_s - self._seen[0] - passed_s
        self._waits_s = max(self._waits_s - passed_s, 0.0)
        if abs(ahead_s) > _DAY_S:
            by_stop = starts and ahead_s > 0
            if not (self._waits_s and by_stop and self._by_stop):
                self._waits_s = _DAY_S
            self._by_stop = by_stop
            _log.warning(
                "the clock is at %s and was expected at %s: until the service has run for %.1f"
                " hours nothing is removed for its age, as the clock may be wrong",
                _shown(now_s),
                _shown(now_s - ahead_s),
                self._waits_s / 3600,
            )
        self._seen = (now_s, ticks_s)
        self._save(now_s)
        return not self._waits_s

    def distrust(self) -> None:
        """Trust the clock only after services have run for a day, as after a stop.

        Raises:
            StorageError: If that cannot be written: a service would trust the clock at once.
            OSError: Likewise.
        """
        self._waits_s, self._by_stop = _DAY_S, True
        self._write(self._wall())

    def _read(self, now_s: float) -> float:
        """Restore the saved wait, and return when it was saved; the present if nothing was."""
        try:
            saved = json.loads(self._path.read_text())
            at_s, waits_s = float(saved["at_s"]), float(saved["waits_s"])
            _shown(at_s)  # raises if no date has it
            if not 0.0 <= waits_s <= _DAY_S:
                raise ValueError(f"a wait is {waits_s:g} s, wanted 0 to {_DAY_S:g}")
            by_stop = bool(saved.get("by_stop", False))
        except FileNotFoundError:
            return now_s
        except (*_DAMAGE, OSError) as error:
            _log.warning("%s cannot be read, it is made again: %s", self._path, error)
            return now_s
        self._waits_s, self._by_stop = waits_s, by_stop
        return at_s

    def _write(self, now_s: float) -> None:
        saved = {"at_s": now_s, "waits_s": self._waits_s, "by_stop": self._by_stop}
        with publish(self._path) as part:
            part.write_text(json.dumps(saved) + "\n")

    def _save(self, now_s: float) -> None:
        try:
            self._write(now_s)
        except (StorageError, OSError) as error:  # on a full disk removing goes on
            _log.warning("%s cannot be written: %s", self._path, error)


def _shown(at_s: float) -> str:
    return f"{datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=at_s):%Y-%m-%d %H:%M}Z"
