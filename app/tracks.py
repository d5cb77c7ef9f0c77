"""Tracks in memory: vehicles' sequences, each pinned to one revision, forgotten when idle."""

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from weakref import WeakValueDictionary

from app.errors import TooManyTracks, TrackNotFound
from core.localizer import Localizer
from core.tracking.step import TrackStep
from core.tracking.track import Observation, Track, Tracker

__all__ = ["LiveTrack", "Tracks"]

_ID_BYTES = 12


@dataclass(eq=False)
class LiveTrack:
    """A track that is kept.

    Attributes:
        id: Its name, hard to guess.
        map_id: The map it belongs to, whatever its slug becomes.
        track: The filter; used under the lock.
        used_s: When it was used last, by the clock of its keeper.
    """

    id: str
    map_id: str
    track: Track
    used_s: float
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def revision(self) -> str:
        """The revision that it is pinned to."""
        return self.track.revision

    @property
    def last(self) -> TrackStep | None:
        """The last answer, `None` before the first observation."""
        return self.track.last

    def observe(self, observation: Observation) -> TrackStep:
        """Take an observation; those of one track are taken one after another.

        Raises:
            StaleObservation: If it is not newer than the last one.
            StaleSignature: If it was made with another revision's bases.
            UnknownSegment: If the map has no such segment.
            InvalidSignature: If it is none of this map.
        """
        with self._lock:
            return self.track.observe(observation)


class Tracks:
    """All tracks of a service; safe to share between threads.

    Args:
        limit: How many are kept.
        idle_s: How long one is kept after it was used last.
        clock: Seconds that never go back.
    """

    def __init__(
        self, limit: int, idle_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._limit = limit
        self.idle_s = idle_s
        self._clock = clock
        self._tracks: dict[str, LiveTrack] = {}
        # What tracks of one revision share lives as long as one of them does.
        self._trackers: WeakValueDictionary[tuple[str, str], Tracker] = WeakValueDictionary()
        self._lock = threading.Lock()
        self._preparing = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
            self._forget_idle()
            return len(self._tracks)

    def create(self, map_id: str, localizer: Localizer) -> LiveTrack:
        """Begin a track in the localizer's revision.

        Raises:
            TooManyTracks: If as many are kept as may be.
        """
        with self._lock:
            self._require_room()
        tracker = self._tracker(map_id, localizer)
        with self._lock:
            self._require_room()
            created = LiveTrack(secrets.token_hex(_ID_BYTES), map_id, Track(tracker), self._clock())
            self._tracks[created.id] = created
        return created

    def get(self, map_id: str, track_id: str) -> LiveTrack:
        """Return a track, and keep it for longer.

        Raises:
            TrackNotFound: If the map has no such track, or no longer.
        """
        with self._lock:
            self._forget_idle()
            found = self._tracks.get(track_id)
            if found is None or found.map_id != map_id:
                raise TrackNotFound(
                    f"there is no track {track_id[:40]!r} of this map; one is forgotten"
                    f" {self.idle_s:g} s after its last use"
                )
            found.used_s = self._clock()
            return found

    def delete(self, map_id: str, track_id: str) -> None:
        """End a track.

        Raises:
            TrackNotFound: If the map has no such track.
        """
        self.get(map_id, track_id)
        with self._lock:
            self._tracks.pop(track_id, None)

    def _tracker(self, map_id: str, localizer: Localizer) -> Tracker:
        key = (map_id, localizer.map.revision)
        with self._preparing:
            tracker = self._trackers.get(key)
            if tracker is None:
                tracker = self._trackers[key] = Tracker(localizer)
            return tracker

    def _require_room(self) -> None:
        self._forget_idle()
        if len(self._tracks) >= self._limit:
            raise TooManyTracks(
                f"{self._limit} tracks are kept, as many as may be: delete one, or wait until one"
                f" is idle for {self.idle_s:g} s"
            )

    def _forget_idle(self) -> None:
        oldest_s = self._clock() - self.idle_s
        for idle in [t.id for t in self._tracks.values() if t.used_s < oldest_s]:
            del self._tracks[idle]
