"""Tracks in memory: vehicles' sequences, each pinned to one revision, forgotten when idle.

Keys share them: each may keep so many, and where all are taken, a key that has less than its share
takes one of the key that has most.
"""

import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from weakref import WeakValueDictionary

from app.http.errors import TooManyTracks, TooManyTracksOfKey, TrackNotFound
from core.localization.localizer import Localizer
from core.tracking.step import TrackStep
from core.tracking.track import Observation, Track, Tracker

_ID_BYTES = 12


@dataclass(eq=False)
class LiveTrack:
    """A track that is kept.

    Attributes:
        id: Its name, hard to guess.
        map_id: The map it belongs to, whatever its slug becomes.
        key_id: Of the key that began it.
        track: The filter; used under the lock.
        used_s: When it was used last, by the clock of its keeper.
    """

    id: str
    map_id: str
    key_id: str
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
        per_key: How many are kept of one key.
        clock: Seconds that never go back.
    """

    def __init__(
        self,
        limit: int,
        idle_s: float,
        per_key: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limit = limit
        self._per_key = per_key
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

    def create(self, map_id: str, key_id: str, localizer: Localizer) -> LiveTrack:
        """Begin a track in the localizer's revision.

        Where as many are kept as may be, a key that has less than its share (the limit by how many
        keys have one) gets the room of the track that was idle for longest, of those of the key
        that has most.

        Raises:
            TooManyTracksOfKey: If as many of this key are kept as may be.
            TooManyTracks: If as many are kept as may be, and the key has its share of them.
        """
        with self._lock:
            self._in_the_way(key_id)
        tracker = self._tracker(map_id, localizer)
        with self._lock:
            if (evicted := self._in_the_way(key_id)) is not None:
                del self._tracks[evicted.id]
            track_id = secrets.token_hex(_ID_BYTES)
            created = LiveTrack(track_id, map_id, key_id, Track(tracker), self._clock())
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

    def _in_the_way(self, key_id: str) -> LiveTrack | None:
        """Return the track that has to go for another one of this key, `None` if none has to."""
        self._forget_idle()
        kept = Counter(track.key_id for track in self._tracks.values())
        wait = f"delete one, or wait until one is idle for {self.idle_s:g} s"
        if kept[key_id] >= self._per_key:
            raise TooManyTracksOfKey(
                f"{kept[key_id]} tracks of key {key_id} are kept, as many as may be: {wait}"
            )
        if len(self._tracks) < self._limit:
            return None
        if (kept[key_id] + 1) * len(kept | Counter([key_id])) > self._limit:
            raise TooManyTracks(f"{self._limit} tracks are kept, as many as may be: {wait}")
        [(most, _)] = kept.most_common(1)
        of_it = (track for track in self._tracks.values() if track.key_id == most)
        return min(of_it, key=lambda track: track.used_s)

    def _forget_idle(self) -> None:
        oldest_s = self._clock() - self.idle_s
        for idle in [t.id for t in self._tracks.values() if t.used_s < oldest_s]:
            del self._tracks[idle]
