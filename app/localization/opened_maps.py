"""The maps that queries among all maps opened."""

import threading
from collections import OrderedDict
from functools import partial

from app.loading import Loading, without_loading
from app.revisions.loaded import Answering, LoadedRevisions
from core.localization.localizer import Localizer
from storage.catalog import MapSummary


class OpenedMaps:
    """A cache of the maps opened last, besides the revisions of queries that name a map.

    It does not replace those, and uses them where they are loaded already.

    Args:
        revisions: The cache of the revisions of queries that name a map.
        most_scans: How many scans the maps in the cache have at most, all together.
    """

    def __init__(self, revisions: LoadedRevisions, most_scans: int) -> None:
        self._revisions = revisions
        self.most_scans = most_scans
        self._opened: OrderedDict[tuple[str, str | None], Localizer] = OrderedDict()
        self._scans = 0
        self._lock = threading.Lock()
        self._reading = Loading(self._kept)

    def live(self, of_map: MapSummary, *, keep: bool) -> Localizer:
        """Return the live revision of a map, that of its summary.

        Args:
            of_map: The map.
            keep: Whether it is kept if it was not, instead of those used longest ago.

        Raises:
            MapNotFound: If the map was deleted.
            NoLiveRevision: If it has no revision any more.
            CorruptFile: If its file is damaged.
            StorageBusy: As `LoadedRevisions.live`.
        """
        loaded = without_loading(partial(self._revisions.live, of_map.slug, keep=False))
        if isinstance(loaded, Answering):
            if keep:
                self._keep(of_map.map_id, loaded.localizer)
            return loaded.localizer
        key = of_map.map_id, of_map.revision
        found = self._reading.get(key, partial(self._load, of_map, keep=keep))
        with self._lock:
            if key in self._opened:
                self._opened.move_to_end(key)
        return found

    def _kept(self, key: tuple[str, str | None]) -> Localizer | None:
        with self._lock:
            return self._opened.get(key)

    def _load(self, of_map: MapSummary, *, keep: bool) -> Localizer:
        localizer = self._revisions.live(of_map.slug, keep=False).localizer
        if keep:
            self._keep(of_map.map_id, localizer)
        return localizer

    def _keep(self, map_id: str, localizer: Localizer) -> None:
        key = map_id, localizer.map.revision
        if len(localizer.map) > self.most_scans:
            return
        with self._lock:
            if key not in self._opened:
                self._scans += len(localizer.map)
            self._opened[key] = localizer
            self._opened.move_to_end(key)
            while self._scans > self.most_scans:
                _, replaced = self._opened.popitem(last=False)
                self._scans -= len(replaced.map)
