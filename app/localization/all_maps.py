"""Where among all maps: which maps a query searches."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain

from app.access.caller import Caller
from app.http.client import require_client
from app.http.errors import TooManyMaps
from app.localization.all_maps_answer import AllMapsAnswer, Reason
from app.localization.axis_notes import axis_notes
from app.localization.derived import Derived
from app.localization.opened_maps import OpenedMaps
from app.localization.place_indexes import FEWEST_MAPS, PlaceIndexes
from app.localization.scan_queries import SensorScan
from core.encodings.basis import Basis
from core.encodings.signature import REVISION_PREFIX_BYTES, Signature
from core.errors import InvalidMap, StaleSignature
from core.localization.all_maps import SearchedMap, localize_in_maps
from core.localization.localizer import Localizer
from core.projection.imager import Image, Imager
from storage.catalog import MapSummary
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision, StorageBusy
from storage.store import Store

_LIKELY, _LIKELY_OF_SCAN = 3, 2  # maps of an index that are opened

_log = logging.getLogger("tensormap.localization")


@dataclass(frozen=True)
class _Chosen:
    """The maps to open, those not indexed yet, and how many places the other maps have."""

    to_open: Sequence[MapSummary]
    not_indexed: Mapping[str, Reason]
    other_places: int


class AllMapsSearch:
    """Searches all maps that a caller may see.

    Args:
        store: The store with the maps.
        opened: The maps that queries opened before.
        indexes: The indexes of shared bases.
        most_opened: How many maps one query may open.
    """

    def __init__(
        self,
        store: Store,
        opened: OpenedMaps,
        indexes: PlaceIndexes,
        most_opened: int,
    ) -> None:
        self._store = store
        self._open_maps = opened
        self._indexes = indexes
        self._most_opened = most_opened
        self._derived = Derived()
        self._damaged: set[str | None] = set()  # revisions that are logged as such

    def signature(
        self,
        caller: Caller,
        signatures: Sequence[Signature],
        k: int,
        min_probability: float | None,
    ) -> AllMapsAnswer:
        """Localize a scan's signatures in the maps whose live revision has their basis.

        They name the basis, or one of these revisions.

        Raises:
            MapNotFound: If the caller may see no map.
            NoLiveRevision: If none of the maps has a revision.
            StaleSignature: If none has the basis, or is the revision.
            InvalidSignature: If the signatures do not fit their basis.
            TooManyMaps: If more maps have to be opened than may be.
        """
        maps = self._visible(caller)
        named = signatures[0].revision
        with_basis, others = self._with_basis(maps, named)
        if not with_basis and (basis := self._basis_of_live(maps, named)) is not None:
            # Maps that share the basis do not know the revision.
            signatures = [replace(signature, revision=basis) for signature in signatures]
            with_basis, others = self._with_basis(maps, basis)
        if not with_basis:
            raise StaleSignature(
                f"no map that this key may see has a live revision {named[:64]!r}, or one with that"
                " basis"
            )
        chosen = self._chosen(with_basis, lambda _: signatures)
        left_out = {**others, **chosen.not_indexed}

        def searched() -> Iterator[SearchedMap]:
            for slug, localizer in self._opened(chosen.to_open, left_out):
                try:
                    search = localizer.search(signatures)
                except StaleSignature:  # another revision became live meanwhile
                    left_out[slug] = Reason.OTHER_BASIS
                else:
                    yield SearchedMap(slug, localizer.map, search)

        return _answer(searched(), k, min_probability, maps, left_out, chosen.other_places)

    def scan(
        self,
        caller: Caller,
        read: Callable[[], SensorScan],
        sensor_height_m: float | None,
        k: int,
        min_probability: float | None,
        *,
        with_notes: bool = True,
    ) -> AllMapsAnswer:
        """Localize a scan in all maps that have a live revision.

        Args:
            caller: Who sent it.
            read: Reads the scan; called once, when a map is to be searched.
            sensor_height_m: This scan's sensor height, if it is not the maps'.
            k: Number of matches.
            min_probability: Least probability to accept.
            with_notes: Whether notes on a scan that is not localized are wanted.

        Raises:
            MapNotFound: If the caller may see no map.
            NoLiveRevision: If none of the maps has a revision.
            InvalidScan: If the scan cannot be used.
            TooManyMaps: If more maps have to be opened than may be.
        """
        read_once = cache(read)
        images: dict[Imager, Image] = {}

        def image_of(basis: Basis) -> Image:
            imager = basis.parameters.imager
            if imager not in images:
                scan = read_once().above(imager.sensor_height_m)
                images[imager] = basis.image(scan, sensor_height_m)
            return images[imager]

        answer = self.image(caller, image_of, k, min_probability)
        if answer.found.decision.localized or not with_notes:
            return answer
        scan, heights_m = read_once(), {imager.sensor_height_m for imager in images}
        if sensor_height_m is not None:
            heights_m = {sensor_height_m}
        if mounted := scan.mounting is not None:  # its ground is as far below each of the heights
            heights_m = {max(heights_m)}
        notes = axis_notes(scan.above(max(heights_m)), *heights_m, mounted=mounted)
        return replace(answer, notes=tuple(notes))

    def image(
        self,
        caller: Caller,
        image_of: Callable[[Basis], Image],
        k: int,
        min_probability: float | None,
    ) -> AllMapsAnswer:
        """Localize a scan by its image, in all maps that have a live revision.

        Args:
            caller: Who sent it.
            image_of: Returns its image for the maps of a basis.
            k: Number of matches.
            min_probability: Least probability to accept.

        Raises:
            MapNotFound: If the caller may see no map.
            NoLiveRevision: If none of the maps has a revision.
            TooManyMaps: If more maps have to be opened than may be.
        """
        maps = self._visible(caller)
        live, others = self._derived.of(_live, maps)
        chosen = self._chosen(live, image_of)
        left_out = {**others, **chosen.not_indexed}

        def searched() -> Iterator[SearchedMap]:
            for slug, localizer in self._opened(chosen.to_open, left_out):
                image = image_of(localizer.basis)
                search = localizer.search_image(image)
                yield SearchedMap(slug, localizer.map, search, image.occupied_cells)

        return _answer(searched(), k, min_probability, maps, left_out, chosen.other_places)

    def _visible(self, caller: Caller) -> Sequence[MapSummary]:
        maps = self._store.catalog.map_summaries.all(caller.maps)
        if not maps:
            raise MapNotFound("there is no map that this key may see")
        if all(summary.revision is None for summary in maps):
            raise NoLiveRevision("none of the maps that this key may see has a revision yet")
        return maps

    def _with_basis(
        self, maps: Sequence[MapSummary], named: str
    ) -> tuple[Sequence[MapSummary], Mapping[str, Reason]]:
        """Return the maps whose live revision has a basis, and the others' reasons."""
        having = frozenset[str]()
        if len(named) >= 2 * REVISION_PREFIX_BYTES:
            having = self._store.catalog.map_summaries.with_basis(named)
        return self._derived.of(_split, maps, having)

    def _basis_of_live(self, maps: Sequence[MapSummary], named: str) -> str | None:
        """Return the digest of the basis of a live revision, `None` if none has that name.

        Raises:
            CorruptFile: If its file is damaged, in each map that has it.
        """
        if len(named) < 2 * REVISION_PREFIX_BYTES:
            return None
        damage = None
        for summary in maps:
            if summary.revision is not None and summary.revision.startswith(named):
                require_client()
                try:
                    localizer = self._open_maps.live(summary, keep=True)
                except (MapNotFound, NoLiveRevision):  # deleted meanwhile
                    continue
                except CorruptFile as error:  # another map may have imported the same one
                    damage = error
                    continue
                if localizer.answers(named):
                    return localizer.map.basis_digest
        if damage is not None:
            raise damage
        return None

    def _chosen(
        self,
        maps: Sequence[MapSummary],
        query_of: Callable[[Basis], Sequence[Signature] | Image],
    ) -> _Chosen:
        """Return which of some maps are opened: the most likely of each index, and all others.

        Raises:
            InvalidSignature: If the signatures do not fit their basis.
            TooManyMaps: If there are too many of these.
        """
        of_bases, alone = self._derived.of(_by_basis, maps)
        waiting: list[MapSummary] = []
        likely: list[MapSummary] = []
        places = 0
        for basis, having in of_bases.items():
            index = self._indexes.open(basis)
            indexed, missing = ([], having) if index is None else index.split(having)
            if missing:
                self._indexes.wake(basis, missing)
                waiting += missing
            if index is None or not indexed:
                continue
            query = query_of(index.basis)
            most = _LIKELY_OF_SCAN if isinstance(query, Image) else _LIKELY
            try:
                found = index.nearest_maps(indexed, query)[:most]
            except InvalidMap:  # not the query's fault: a file of the index has been damaged
                _log.exception("the index of basis %s cannot be searched", basis[:12])
                self._indexes.report_damage(basis)
                waiting += indexed
                continue
            likely += found
            places += index.count_places(indexed, without=found)
        if len(alone) + len(likely) > self._most_opened:
            else_to_do = (
                "build the maps with one shared basis"
                if alone
                else "raise TENSORMAP_MAX_MAPS_OPENED"
            )
            raise TooManyMaps(
                f"the query would open {len(alone) + len(likely)} maps, the limit is"
                f" {self._most_opened}: name a map, or {else_to_do}"
            )
        room = self._most_opened - len(alone) - len(likely)
        return _Chosen(
            [*likely, *alone, *waiting[:room]],
            {summary.slug: Reason.NOT_INDEXED for summary in waiting[room:]},
            places,
        )

    def _opened(
        self, maps: Sequence[MapSummary], left_out: dict[str, Reason]
    ) -> Iterator[tuple[str, Localizer]]:
        """Yield the live revisions of maps; add those that cannot be read to `left_out`."""
        room = self._open_maps.most_scans
        for summary in maps:
            require_client()
            # If all were kept, each would replace the one that the next query needs first.
            keep = summary.scans <= room
            room -= summary.scans if keep else 0
            try:
                localizer = self._open_maps.live(summary, keep=keep)
            except CorruptFile as error:
                if summary.revision not in self._damaged:  # else each query would log it
                    _log.error("map %s cannot be searched: %s", summary.slug, error)
                    self._damaged.add(summary.revision)
                left_out[summary.slug] = Reason.DAMAGED
            except (MapNotFound, NoLiveRevision):  # deleted meanwhile
                left_out[summary.slug] = Reason.NO_LIVE_REVISION
            else:
                self._damaged.discard(summary.revision)
                yield summary.slug, localizer


def _answer(
    searched: Iterator[SearchedMap],
    k: int,
    min_probability: float | None,
    maps: Sequence[MapSummary],
    left_out: dict[str, Reason],
    other_places: int,
) -> AllMapsAnswer:
    first = next(searched, None)
    if first is None:
        if Reason.DAMAGED in left_out.values():
            raise CorruptFile(f"none of {len(maps)} maps could be searched")
        raise StorageBusy("the maps that could be searched were deleted or replaced meanwhile")
    every = chain([first], searched)
    found = localize_in_maps(every, k, min_probability=min_probability, other_places=other_places)
    return AllMapsAnswer(found, len(maps) - len(left_out), tuple(sorted(left_out.items())))


def _live(maps: Sequence[MapSummary]) -> tuple[Sequence[MapSummary], Mapping[str, Reason]]:
    """Return the maps that have a live revision, and the others' reasons."""
    return (
        [summary for summary in maps if summary.revision is not None],
        {summary.slug: Reason.NO_LIVE_REVISION for summary in maps if summary.revision is None},
    )


def _split(
    maps: Sequence[MapSummary], having: Set[str]
) -> tuple[Sequence[MapSummary], Mapping[str, Reason]]:
    """Return the maps that have a basis, and the others' reasons."""
    left_out = {
        summary.slug: Reason.NO_LIVE_REVISION if summary.revision is None else Reason.OTHER_BASIS
        for summary in maps
        if summary.map_id not in having
    }
    return [summary for summary in maps if summary.map_id in having], left_out


def _by_basis(
    maps: Sequence[MapSummary],
) -> tuple[Mapping[str, Sequence[MapSummary]], Sequence[MapSummary]]:
    """Return the maps of each basis that has enough for an index, and all others."""
    of_bases: dict[str, list[MapSummary]] = {}
    alone: list[MapSummary] = []
    for summary in maps:
        (alone if summary.basis is None else of_bases.setdefault(summary.basis, [])).append(summary)
    for basis in [basis for basis, having in of_bases.items() if len(having) < FEWEST_MAPS]:
        alone += of_bases.pop(basis)
    return of_bases, alone
