"""A track in memory, and the same one as it is saved."""

import secrets
import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from app.quick_work import LastTimes, NotQuick, must_be_quick
from core.errors import InvalidParameters
from core.tracking.state import TrackState
from core.tracking.step import TrackStep
from core.tracking.track import Observation, Track, Tracker
from storage.catalog import SavedTrack

_ID_BYTES = 12


class TrackUnloaded(Exception):
    """The track was saved and is not in memory any more: get the track again to continue."""


def new_track(map_id: str, key_id: str, revision: str, now_s: float) -> SavedTrack:
    """Return a new track, with a name that is hard to guess."""
    name = secrets.token_hex(_ID_BYTES)
    return SavedTrack(name, map_id, key_id, revision, datetime.now(UTC), now_s)


class LiveTrack(Track):
    """A track of the service; safe to share between threads.

    Args:
        tracker: The tracker of its revision.
        saved: As it was saved; it goes on from there.
        clock: Unix time in seconds, which is saved.
        monotonic: Seconds that go on whatever the clock is set to.

    Raises:
        InvalidParameters: If what was saved is of another version or map.

    Attributes:
        id: The track's id, hard to guess.
        map_id: The map it belongs to, whatever its slug becomes.
        key_id: Id of the key that created it.
        used_s: Unix time of its last use, by the clock as it was then.
        used_at_s: The same by `monotonic`.
        saved: As it was saved last.
    """

    def __init__(
        self,
        tracker: Tracker,
        saved: SavedTrack,
        clock: Callable[[], float],
        monotonic: Callable[[], float],
    ) -> None:
        now_s = clock()
        super().__init__(tracker, _state_of(saved.state))
        self.id, self.map_id, self.key_id = saved.id, saved.map_id, saved.key_id
        self.used_s = saved.used_s
        self.saved = saved
        self._clock, self._monotonic = clock, monotonic
        self.used_at_s = monotonic() - max(now_s - saved.used_s, 0.0)
        self._observed_s = saved.observed_s
        gap_s = now_s - (saved.observed_s or saved.used_s)
        self._observed_at_s = monotonic() - max(gap_s, 0.0)
        self._times = LastTimes()
        self._unloaded = False
        self._lock = threading.Lock()

    def use(self) -> None:
        """Renew its time of use."""
        self.used_s, self.used_at_s = self._clock(), self._monotonic()

    @property
    def is_changed(self) -> bool:
        """Whether it was used since it was saved."""
        now, before = (self.used_s, self.observations), (self.saved.used_s, self.saved.observations)
        return now != before

    def observe(self, observation: Observation) -> TrackStep:
        """Take an observation, one at a time; see `Track.observe`.

        Raises:
            TrackUnloaded: If it is not in memory any more.
            NotQuick: If it has to be quick, and the last observation was not or one is being taken.
        """
        if not self._lock.acquire(blocking=not must_be_quick()):
            raise NotQuick
        try:
            if self._unloaded:
                raise TrackUnloaded(self.id)
            if self.continues:
                self.gap_s = self._monotonic() - self._observed_at_s
            with self._times.measured():
                step = super().observe(observation)
            self._observed_s = self._clock()
            return step
        finally:
            self._lock.release()

    def unload(self) -> bool:
        """Take no more observations, and return `True`, if it is saved as it is and not in use."""
        if not self._lock.acquire(blocking=False):
            return False
        try:
            self._unloaded = not self.is_changed
            return self._unloaded
        finally:
            self._lock.release()

    def to_save(self, answer: Callable[[TrackStep, Collection[str]], dict[str, Any]]) -> SavedTrack:
        """Return the track as it is now.

        Args:
            answer: Returns an answer in a map with such drives aside, in plain values.
        """
        aside = self.localizer.map.drives_aside
        with self._lock:
            return replace(
                self.saved,
                used_s=self.used_s,
                observed_s=self._observed_s,
                observations=self.observations,
                state=vars(self.state),
                last=self.saved.last if self.last is None else answer(self.last, aside),
            )


def _state_of(saved: dict[str, Any] | None) -> TrackState | None:
    """Return a saved state.

    Raises:
        InvalidParameters: If it has other fields or values.
    """
    if saved is None:
        return None
    try:
        places = tuple((int(place), float(share)) for place, share in saved["places"])
        return TrackState(**{**saved, "places": places, "periods_s": tuple(saved["periods_s"])})
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidParameters(f"the saved state of a track cannot be read: {error!r}") from error
