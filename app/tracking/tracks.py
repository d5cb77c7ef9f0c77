"""Tracks in memory, each of one vehicle in one revision, removed when idle.

The number of all tracks and of each key's is limited. At the limit of all, a key with less than its
share replaces a track of the key with the most.
"""

import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable
from weakref import WeakValueDictionary

from app.http.errors import TooManyTracks, TooManyTracksOfKey, TrackNotFound
from core.localization.localizer import Localizer
from core.tracking.step import TrackStep
from core.tracking.track import Observation, Track, Tracker

_ID_BYTES = 12


class LiveTrack(Track):
    """A track of the service; safe to share between threads.

    Attributes:
        id: Its name, hard to guess.
        map_id: The map it belongs to, whatever its slug becomes.
        key_id: Of the key that created it.
        used_s: Time of its last use, by the clock of `Tracks`.
    """

    def __init__(self, tracker: Tracker, map_id: str, key_id: str, used_s: float) -> None:
        super().__init__(tracker)
        self.id = secrets.token_hex(_ID_BYTES)
        self.map_id = map_id
        self.key_id = key_id
        self.used_s = used_s
        self._lock = threading.Lock()

    def observe(self, observation: Observation) -> TrackStep:
        """Take an observation, one at a time; see `Track.observe`."""
        with self._lock:
            return super().observe(observation)


class Tracks:
    """All tracks of a service; safe to share between threads.

    Args:
        limit: Most tracks.
        idle_s: Time after its last use when a track is removed.
        per_key: Most tracks of one key.
        clock: Monotonic seconds.
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
        # The tracker of a revision is shared by its tracks, and freed with the last of them.
        self._trackers: WeakValueDictionary[tuple[str, str], Tracker] = WeakValueDictionary()
        self._lock = threading.Lock()
        self._preparing = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
            self._remove_idle()
            return len(self._tracks)

    def create(self, map_id: str, key_id: str, localizer: Localizer) -> LiveTrack:
        """Create a track in the localizer's revision.

        At the limit, a key with less than its share (the limit divided by the number of keys with
        tracks) replaces the track of the key with the most that was idle for longest.

        Raises:
            TooManyTracksOfKey: If the key has as many tracks as it may.
            TooManyTracks: If all keys together have, and this key has its share.
        """
        with self._lock:
            self._to_evict(key_id)  # before a tracker is made, which takes long
        revision = (map_id, localizer.map.revision)
        with self._preparing:
            tracker = self._trackers.get(revision)
            if tracker is None:
                tracker = self._trackers[revision] = Tracker(localizer)
        with self._lock:
            if (evicted := self._to_evict(key_id)) is not None:
                del self._tracks[evicted.id]
            created = LiveTrack(tracker, map_id, key_id, self._clock())
            self._tracks[created.id] = created
        return created

    def get(self, map_id: str, track_id: str) -> LiveTrack:
        """Return a track and renew its time of use.

        Raises:
            TrackNotFound: If the map has no such track, or it was removed.
        """
        with self._lock:
            self._remove_idle()
            found = self._tracks.get(track_id)
            if found is None or found.map_id != map_id:
                raise TrackNotFound(
                    f"there is no track {track_id[:40]!r} of this map; a track is removed"
                    f" {self.idle_s:g} s after its last use"
                )
            found.used_s = self._clock()
            return found

    def delete(self, map_id: str, track_id: str) -> None:
        """Remove a track.

        Raises:
            TrackNotFound: If the map has no such track.
        """
        self.get(map_id, track_id)
        with self._lock:
            self._tracks.pop(track_id, None)

    def _to_evict(self, key_id: str) -> LiveTrack | None:
        """Return the track to remove for a new one of this key, `None` if there is room."""
        self._remove_idle()
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

    def _remove_idle(self) -> None:
        oldest_s = self._clock() - self.idle_s
        for idle in [t.id for t in self._tracks.values() if t.used_s < oldest_s]:
            del self._tracks[idle]
