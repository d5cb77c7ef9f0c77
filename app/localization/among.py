"""Where among all maps: which maps a query searches, and the answer of these."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

from app.access.caller import Caller
from app.http.client import require_client
from app.http.errors import TooManyMaps
from app.revisions.loaded import LoadedRevisions
from core.encodings.signature import REVISION_PREFIX_BYTES, Signature
from core.errors import StaleSignature
from core.localization.among_maps import LocalizationAmong, SearchedMap, localize_among
from core.localization.localizer import Localizer
from core.projection.imager import Image, Imager
from core.scans.scan import Scan
from storage.catalog import LiveMap
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision
from storage.store import Store

_log = logging.getLogger("tensormap.localization")


class Reason(StrEnum):
    """Why a map was not searched."""

    NO_LIVE_REVISION = "no_live_revision"
    OTHER_BASIS = "other_basis"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class Among:
    """An answer, and what it was searched in.

    Attributes:
        found: The answer.
        searched: How many maps were searched.
        not_searched: The other maps that the key may see, in the order of their names, and why.
    """

    found: LocalizationAmong
    searched: int
    not_searched: tuple[tuple[str, Reason], ...]


class AmongMaps:
    """Searches all maps that a caller may see.

    Args:
        store: With the maps.
        revisions: Opened ones.
        most_opened: How many maps one query may open.
    """

    def __init__(self, store: Store, revisions: LoadedRevisions, most_opened: int) -> None:
        self._store = store
        self._revisions = revisions
        self._most_opened = most_opened

    def signature(
        self,
        caller: Caller,
        signatures: Sequence[Signature],
        k: int,
        min_probability: float | None,
    ) -> Among:
        """Localize a scan's signatures in the maps whose live revision has their basis.

        Raises:
            MapNotFound: If the caller may see no map.
            NoLiveRevision: If none of the maps has a revision.
            StaleSignature: If none has the basis.
            InvalidSignature: If the signatures do not fit their basis.
            TooManyMaps: If more maps have to be opened than may be.
        """
        maps = self._visible(caller)
        named = signatures[0].revision
        having = frozenset[str]()
        if len(named) >= 2 * REVISION_PREFIX_BYTES:
            having = self._store.catalog.live_maps.with_basis(named)
        with_basis = [one for one in maps if one.map_id in having]
        if not with_basis:
            raise StaleSignature(
                f"no live revision of a map that this key may see has basis {named[:64]!r}"
            )
        self._require_few(with_basis)
        damaged: set[str] = set()
        searched = []
        for slug, localizer in self._opened(with_basis, damaged):
            with suppress(StaleSignature):  # another revision became live meanwhile
                search = localizer.search(signatures)
                searched.append(SearchedMap(slug, localizer.map, search))
        return _answer(searched, k, min_probability, maps, with_basis, damaged)

    def scan(
        self,
        caller: Caller,
        read: Callable[[float], Scan],
        sensor_height_m: float | None,
        k: int,
        min_probability: float | None,
    ) -> Among:
        """Localize a scan in all maps that have a live revision.

        Args:
            caller: Who sent it.
            read: Returns the scan as one for maps of a sensor at some height.
            sensor_height_m: Of this scan, if it is another than the maps'.
            k: Number of matches.
            min_probability: Least probability to accept.

        Raises:
            MapNotFound: If the caller may see no map.
            NoLiveRevision: If none of the maps has a revision.
            InvalidScan: If the scan cannot be used.
            TooManyMaps: If more maps have to be opened than may be.
        """
        maps = self._visible(caller)
        live = [one for one in maps if one.revision is not None]
        self._require_few(live)
        images: dict[Imager, Image] = {}
        damaged: set[str] = set()
        searched = []
        for slug, localizer in self._opened(live, damaged):
            imager = localizer.map.parameters.imager
            if imager not in images:
                scan = read(imager.sensor_height_m)
                images[imager] = localizer.basis.image(scan, sensor_height_m)
            image = images[imager]
            search = localizer.search_image(image)
            searched.append(SearchedMap(slug, localizer.map, search, image.occupied_cells))
        return _answer(searched, k, min_probability, maps, live, damaged)

    def _visible(self, caller: Caller) -> list[LiveMap]:
        maps = [one for one in self._store.catalog.live_maps.all() if caller.sees(one.slug)]
        if not maps:
            raise MapNotFound("there is no map that this key may see")
        if all(one.revision is None for one in maps):
            raise NoLiveRevision("none of the maps that this key may see has a revision yet")
        return maps

    def _require_few(self, maps: Sequence[LiveMap]) -> None:
        if len(maps) > self._most_opened:
            raise TooManyMaps(
                f"{len(maps)} maps would have to be opened, at most {self._most_opened} may be:"
                " name a map, or build the maps with one shared basis"
            )

    def _opened(
        self, maps: Iterable[LiveMap], damaged: set[str]
    ) -> Iterator[tuple[str, Localizer]]:
        """Yield the live revisions of maps; add the names of those that cannot be read."""
        for one in maps:
            require_client()
            try:
                yield one.slug, self._revisions.live(one.slug).localizer
            except CorruptFile:
                _log.exception("map %s cannot be searched", one.slug)
                damaged.add(one.slug)
            except (MapNotFound, NoLiveRevision):  # deleted meanwhile
                pass


def _answer(
    searched: Sequence[SearchedMap],
    k: int,
    min_probability: float | None,
    maps: Sequence[LiveMap],
    chosen: Sequence[LiveMap],
    damaged: set[str],
) -> Among:
    if not searched:
        raise CorruptFile(
            f"none of {len(chosen)} maps could be searched, {len(damaged)} cannot be read"
        )
    slugs = {one.slug for one in chosen}
    left_out = [
        (one.slug, _reason(one, damaged))
        for one in maps
        if one.slug in damaged or one.slug not in slugs
    ]
    found = localize_among(searched, k, min_probability=min_probability)
    return Among(found, len(slugs - damaged), tuple(left_out))


def _reason(one: LiveMap, damaged: set[str]) -> Reason:
    if one.revision is None:
        return Reason.NO_LIVE_REVISION
    return Reason.DAMAGED if one.slug in damaged else Reason.OTHER_BASIS
