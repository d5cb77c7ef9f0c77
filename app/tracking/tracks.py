"""The tracks of a service, each of one vehicle in one revision, removed when idle.

A track that this process has not in memory was saved by another one, or by an earlier process of
this service: it goes on from there. The number of all tracks and of each key's is limited. At the
limit of all, a key with less than its share replaces a track of the key with the most. The number
of revisions in memory is limited too: the tracks of that used longest ago are unloaded for another.
"""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from weakref import WeakValueDictionary

from app.http.errors import TooManyTracks, TooManyTracksOfKey, TrackNotFound
from app.loading import Loading
from app.tracking.live_track import LiveTrack, new_track
from app.tracking.schemas import saved_answer
from core.errors import InvalidParameters
from core.localization.localizer import Localizer
from core.text import count_of
from core.tracking.track import Tracker
from storage.catalog import Page, SavedTrack, SavedTracks
from storage.errors import StorageFailure

_CLOCK_SET_S = 3600.0  # set forward by that, what is saved of tracks in use only seems to be idle

_log = logging.getLogger("tensormap.tracks")


class Tracks:
    """All tracks of a service; safe to share between threads.

    Args:
        limit: Most tracks.
        idle_s: Time after its last use when a track is removed.
        per_key: Most tracks of one key.
        revisions: Most revisions whose tracks are in memory, but for those in use at the moment.
        saved: The saved tracks, of other processes too.
        clock: Unix time in seconds, for what is saved: other processes have it too.
        monotonic: Seconds that go on whatever the clock is set to, for tracks in memory.
    """

    def __init__(
        self,
        limit: int,
        idle_s: float,
        per_key: int,
        revisions: int,
        saved: SavedTracks,
        clock: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limit = limit
        self._per_key = per_key
        self._most_revisions = revisions
        self.idle_s = idle_s
        self._clock, self._monotonic = clock, monotonic
        self._saved = saved
        # Unloaded ones and those of an earlier process count too, and are in memory from their
        # next use on.
        self._tracks: dict[str, LiveTrack | SavedTrack] = {
            track.id: track for track in self._saved.used_since(clock() - idle_s)
        }
        # The tracker of a revision is shared by its tracks, and freed with the last of them.
        self._trackers: WeakValueDictionary[tuple[str, str], Tracker] = WeakValueDictionary()
        self._preparing = Loading(self._trackers.get)
        self._leaving: set[str] = set()  # until the tracks that replace them are saved
        self._lock = threading.Lock()
        self._saving = threading.Lock()
        self._making_room = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
            self._remove_idle()
            return len(self._tracks)

    def create(self, map_id: str, key_id: str, localizer: Localizer) -> LiveTrack:
        """Create a track in the localizer's revision.

        At the limit, a key with less than its share (the limit divided by the number of keys with
        tracks) replaces the track of the key with the most that was idle for longest.

        Raises:
            TooManyTracksOfKey: If the key's limit of tracks is reached.
            TooManyTracks: If all keys together have, and this key has its share.
            StorageError: If it cannot be saved; then no track is replaced.
        """
        with self._lock:
            self._to_evict(key_id)  # before a tracker is made, which takes long
        tracker = self._tracker(map_id, localizer)
        with self._lock:
            evicted = self._to_evict(key_id)
            leaving = set() if evicted is None else {evicted.id}
            now_s = self._clock()
            saved = new_track(map_id, key_id, tracker.map.revision, now_s)
            created = LiveTrack(tracker, saved, self._clock, self._monotonic)
            self._tracks[created.id] = created
            self._leaving |= leaving
        removed = {created.id}
        try:
            self._saved.add(saved, now_s - self.idle_s - _CLOCK_SET_S, leaving)
            removed = leaving
        finally:
            with self._lock:
                self._leaving -= leaving
                for track_id in removed:
                    self._tracks.pop(track_id, None)
        return created

    def get(
        self, map_id: str, track_id: str, localizer_of: Callable[[str], Localizer] | None = None
    ) -> LiveTrack:
        """Return a track and renew its time of use.

        Args:
            map_id: The map.
            track_id: The track.
            localizer_of: Returns that of a revision, for a track that another process had.

        Raises:
            TrackNotFound: If the map has no such track, or it was removed.
        """
        found = self._find(map_id, track_id)
        if not isinstance(found, LiveTrack):
            if localizer_of is None:
                raise self._not_found(track_id)
            found = self._resumed(found, localizer_of)
        found.use()
        return found

    def delete(self, map_id: str, track_id: str) -> None:
        """Remove a track.

        Raises:
            TrackNotFound: If the map has no such track.
        """
        self._find(map_id, track_id)
        self._saved.remove(track_id)
        with self._lock:
            self._tracks.pop(track_id, None)

    def remove_of_map(self, map_id: str) -> None:
        """Remove the tracks of a map that was deleted: none can be found, and they count no more.

        What cannot be removed of those saved is when it is idle.
        """
        with self._lock:
            for track in [track for track in self._tracks.values() if track.map_id == map_id]:
                del self._tracks[track.id]
        with suppress(StorageFailure):
            self._saved.remove_of_map(map_id)

    def page(
        self, map_id: str, after: str, limit: int, key_id: str | None = None
    ) -> Page[SavedTrack]:
        """Return the tracks of a map as they are now, of all keys or of one, ordered by name."""
        since_s = self._clock() - self.idle_s
        page = self._saved.page(map_id, after, limit, used_since_s=since_s, key_id=key_id)
        with self._lock:
            own = [self._tracks.get(track.id) for track in page.items]
        items = (
            (isinstance(mine, LiveTrack) and _now(mine)) or track
            for mine, track in zip(own, page.items, strict=True)
        )
        return replace(page, items=tuple(items))

    def save(self) -> None:
        """Save what changed; a track that another process has gone on with is read anew.

        A track that cannot be saved stays as it is, in memory and saved.
        """
        with self._saving:
            with self._lock:
                self._remove_idle()
                changed = [
                    track
                    for track in self._tracks.values()
                    if isinstance(track, LiveTrack) and track.is_changed
                ]
            now = [(track, saved) for track in changed if (saved := _now(track)) is not None]
            if not now:
                return
            lost = self._saved.update((track.saved.observations, saved) for track, saved in now)
            with self._lock:
                for track, saved in now:
                    track.saved = saved
                    if track.id in lost and self._tracks.get(track.id) is track:
                        del self._tracks[track.id]

    def close(self) -> None:
        """Close what they are saved in."""
        self._saved.close()

    def _find(self, map_id: str, track_id: str) -> LiveTrack | SavedTrack:
        """Return a track: of this process if it has it, else as another one saved it."""
        found = self._tracks.get(track_id)
        if isinstance(found, LiveTrack) and self._is_idle(found):
            with self._lock:
                self._remove_idle()
            found = None  # another process may have gone on with it
        if not isinstance(found, LiveTrack):
            found = self._saved.get(track_id)
        if found is None or found.map_id != map_id or self._is_idle(found):
            raise self._not_found(track_id)
        return found

    def _resumed(self, saved: SavedTrack, localizer_of: Callable[[str], Localizer]) -> LiveTrack:
        tracker = self._trackers.get((saved.map_id, saved.revision))
        if tracker is None:
            tracker = self._tracker(saved.map_id, localizer_of(saved.revision))
        try:
            resumed = LiveTrack(tracker, saved, self._clock, self._monotonic)
        except InvalidParameters as error:  # saved by another version
            raise self._not_found(saved.id) from error
        with self._lock:
            found = self._tracks.get(saved.id)
            if isinstance(found, LiveTrack):  # another thread was first
                return found
            self._tracks[saved.id] = resumed
        return resumed

    def _tracker(self, map_id: str, localizer: Localizer) -> Tracker:
        revision = (map_id, localizer.map.revision)
        return self._preparing.get(revision, partial(self._prepare, revision, localizer))

    def _prepare(self, revision: tuple[str, str], localizer: Localizer) -> Tracker:
        tracker = Tracker(localizer)  # without the lock: it takes long
        with self._making_room:
            self._make_room()
            self._trackers[revision] = tracker
        return tracker

    def _make_room(self) -> None:
        """Unload the tracks of the revisions used longest ago, to have room for another one."""
        # Those without a track yet count too.
        excess = len(self._trackers) + 1 - self._most_revisions
        if excess <= 0:
            return
        self.save()
        with self._lock:
            of_revision: dict[tuple[str, str], list[LiveTrack]] = {}
            for track in self._tracks.values():
                if isinstance(track, LiveTrack):
                    of_revision.setdefault((track.map_id, track.revision), []).append(track)
            by_use = sorted(of_revision.values(), key=lambda of: max(t.used_at_s for t in of))
            for unused in by_use[:excess]:
                for track in unused:
                    if track.unload():
                        self._tracks[track.id] = track.saved

    def _not_found(self, track_id: str) -> TrackNotFound:
        return TrackNotFound(
            f"there is no track {track_id[:40]!r} of this map; a track is removed"
            f" {self.idle_s:g} s after its last use"
        )

    def _to_evict(self, key_id: str) -> LiveTrack | SavedTrack | None:
        """Return the track to remove for a new one of this key, `None` if there is room."""
        self._remove_idle()
        staying = [track for track in self._tracks.values() if track.id not in self._leaving]
        kept = Counter(track.key_id for track in staying)
        wait = f"delete one, or wait until one is idle for {self.idle_s:g} s"
        if kept[key_id] >= self._per_key:
            raise TooManyTracksOfKey(
                f"key {key_id} has reached the limit of {count_of(self._per_key, 'track')}: {wait}"
            )
        if len(staying) < self._limit:
            return None
        if (kept[key_id] + 1) * len(kept | Counter([key_id])) > self._limit:
            raise TooManyTracks(
                f"the limit of {count_of(self._limit, 'track')} of the service is reached: {wait}"
            )
        [(most, _)] = kept.most_common(1)
        of_it = (track for track in staying if track.key_id == most)
        return max(of_it, key=self._unused_s)

    def _remove_idle(self) -> None:
        for idle in [track.id for track in self._tracks.values() if self._is_idle(track)]:
            del self._tracks[idle]

    def _is_idle(self, track: LiveTrack | SavedTrack) -> bool:
        return self._unused_s(track) > self.idle_s

    def _unused_s(self, track: LiveTrack | SavedTrack) -> float:
        if isinstance(track, LiveTrack):
            return self._monotonic() - track.used_at_s
        return self._clock() - track.used_s


def _now(track: LiveTrack) -> SavedTrack | None:
    """Return a track as it is now, `None` if it cannot be saved."""
    try:
        return track.to_save(saved_answer)
    except Exception:  # noqa: BLE001 - whatever is wrong with one track, the others are saved
        _log.exception("track %s cannot be saved", track.id)
        return None
