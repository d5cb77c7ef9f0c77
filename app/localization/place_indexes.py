"""Indexes of the places of all maps of a shared basis: kept up to date, and searched."""

import logging
import threading
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import IntArray
from core.encodings.basis import Basis
from core.encodings.model import Model
from core.encodings.place_index import PlaceEntries, PlaceIndex
from core.encodings.signature import Signature
from core.errors import InvalidMap, TensorMapError
from storage.catalog import LiveMap
from storage.errors import BasisNotFound, CorruptFile
from storage.files.map_file import read_revision
from storage.files.place_files import VERSION, IndexedMap, Manifest, Part, PlaceFiles
from storage.store import Store

FEWEST_MAPS = 9
"""Of one basis that are indexed: fewer are opened, and stay open."""

_AT_ONCE = 200  # maps that are read before their part is written, in some 300 MB
_MOST_SAMPLES = 80  # maps of which a code is made
_GROWN = 4  # times as many places: another code, with more lists, is worth while
_MOST_DEAD = 0.25  # of the places of a part
_SMALLER = 4  # a part that is not so many times larger than a new one is joined with it
_MOST_JOINED = 200_000  # places: a part is made in memory, 1.5 kB each
_ATTEMPTS = 3

_log = logging.getLogger("tensormap.localization")


@dataclass(frozen=True, eq=False)
class OpenIndex:
    """An index whose files are mapped into memory.

    Attributes:
        basis: Of its maps.
        index: How it is searched.
        parts: Each part's entries and maps.
        places_of: Part and places of each map by its id.
    """

    basis: Basis
    index: PlaceIndex[Any]
    parts: tuple[tuple[PlaceEntries, Part], ...]
    places_of: Mapping[str, tuple[int, IndexedMap]]

    def has(self, one: LiveMap) -> bool:
        """Return whether the live revision of a map is indexed."""
        found = self.places_of.get(one.map_id)
        return found is not None and found[1].revision == one.revision

    def nearest_maps(self, maps: Sequence[LiveMap], signature: Signature) -> list[str]:
        """Return the ids of the maps that a signature may be of, the most likely first.

        Args:
            maps: Those that may be found, all of them indexed.
            signature: Of this basis.
        """
        searched = []
        for number, (entries, part) in enumerate(self.parts):
            spans = [
                place
                for one in maps
                for of_part, place in [self.places_of[one.map_id]]
                if of_part == number
            ]
            if spans:
                places = None if len(spans) == len(part.maps) else _all_of(spans)
                found = self.index.candidates(entries, signature, places)
                searched.append((part, (entries, *found)))
        compared = self.index.most_alike(signature, [found for _, found in searched])
        nearest: dict[str, float] = {}
        for (part, _), (places, distances) in zip(searched, compared, strict=True):
            starts = [one.start for one in part.maps]
            for place, distance in zip(places.tolist(), distances.tolist(), strict=True):
                one = part.maps[bisect_right(starts, place) - 1]
                if one.start <= place < one.end:  # else its map is gone
                    nearest[one.map_id] = min(distance, nearest.get(one.map_id, np.inf))
        return sorted(nearest, key=lambda map_id: nearest[map_id])


def _all_of(spans: Iterable[IndexedMap]) -> IntArray:
    ordered = sorted((one.start, one.end) for one in spans)
    return np.concatenate([np.arange(start, end) for start, end in ordered])


class PlaceIndexes:
    """The indexes of all shared bases; a thread of its own brings them up to date.

    Args:
        store: With the bases and revisions.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._open: dict[str, tuple[tuple[int, int], OpenIndex]] = {}
        self._pending: set[str] = set()
        self._changed = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._loop, name="place indexes", daemon=True)

    def start(self) -> None:
        """Bring all indexes up to date, then those that `wake` names."""
        self._thread.start()
        for basis in {one.basis for one in self._store.catalog.live_maps.all()} - {None}:
            self.wake(str(basis))

    def stop(self) -> None:
        """Stop after the maps that are being read."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread.ident is not None:
            self._thread.join()

    def wake(self, basis: str) -> None:
        """Bring the index of a basis up to date soon: a map is not in it, or no longer live."""
        with self._changed:
            self._pending.add(basis)
            self._changed.notify()

    def open(self, basis: str) -> OpenIndex | None:
        """Return the index of a basis, `None` if there is none that can be read."""
        files = self._files(basis)
        for _ in range(_ATTEMPTS):
            written = files.written()
            if written is None:
                return None
            known = self._open.get(basis)
            if known is not None and known[0] == written:
                return known[1]
            try:
                opened = self._read(basis, files)
            except (OSError, ValueError, TypeError, InvalidMap, TensorMapError):
                continue  # replaced meanwhile, or damaged: then it is made again
            self._open[basis] = written, opened
            return opened
        _log.warning("the index of basis %s cannot be read: it is made again", basis[:12])
        return None

    def _read(self, basis: str, files: PlaceFiles) -> OpenIndex:
        manifest = files.manifest()
        if manifest is None:
            raise InvalidMap("the index has no manifest")
        of_maps = self._store.bases.read(basis)
        kind = of_maps.parameters.encoder.place_index()
        if kind is None:
            raise InvalidMap(f"{of_maps.parameters.encoding} maps have no index")
        index = kind.of(of_maps, files.read(manifest.code))
        parts = tuple((index.read(files.read(part.folder)), part) for part in manifest.parts)
        return OpenIndex(
            of_maps,
            index,
            parts,
            {
                one.map_id: (number, one)
                for number, (_, part) in enumerate(parts)
                for one in part.maps
            },
        )

    def _files(self, basis: str) -> PlaceFiles:
        return PlaceFiles(self._store.layout.index / basis)

    def _loop(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._pending or self._stopping)
                if self._stopping:
                    return
                basis = self._pending.pop()
            try:
                self.update(basis)
            except (TensorMapError, OSError):
                _log.exception("the index of basis %s cannot be brought up to date", basis[:12])

    def update(self, basis: str) -> None:
        """Add the maps that an index lacks, and remove those that are not live; others stay.

        Of two processes one does it.

        Raises:
            StorageFull: If no space is left.
        """
        files = self._files(basis)
        live = {
            one.map_id: one
            for one in self._store.catalog.live_maps.all()
            if one.basis == basis and one.revision is not None
        }
        if len(live) < FEWEST_MAPS:
            files.remove()
            return
        with files.locked() as alone:
            if alone:
                with suppress(BasisNotFound):  # deleted meanwhile
                    self._update(basis, files, live)

    def _update(self, basis: str, files: PlaceFiles, live: Mapping[str, LiveMap]) -> None:
        opened, manifest = self.open(basis), files.manifest()
        places = sum(one.scans for one in live.values())
        if opened is None or manifest is None or places > _GROWN * manifest.trained:
            of_maps = self._store.bases.read(basis)
            kind = of_maps.parameters.encoder.place_index()
            if kind is None:
                return
            maps = list(live.values())
            sample = [model for _, model in self._models(maps[:: -(-len(maps) // _MOST_SAMPLES)])]
            if not sample:
                return
            index = kind.train(of_maps, sample, places)
            code = files.write("code", index.arrays())
            manifest = Manifest(version=VERSION, code=code, trained=places, parts=[])
            files.replace(manifest)
        indexed = {
            one.map_id for part in manifest.parts for one in part.maps if _is_live(one, live)
        }
        missing = [one for one in live.values() if one.map_id not in indexed]
        for start in range(0, max(len(missing), 1), _AT_ONCE):
            found = list(self._models(missing[start : start + _AT_ONCE]))
            self._add(self._read(basis, files), manifest, files, live, found)
            manifest = files.manifest() or manifest
            if self._stopping:
                return

    @staticmethod
    def _add(
        opened: OpenIndex,
        manifest: Manifest,
        files: PlaceFiles,
        live: Mapping[str, LiveMap],
        found: Sequence[tuple[LiveMap, Model]],
    ) -> None:
        """Add some maps in a part of their own, joined with parts that are small or mostly gone."""
        index = opened.index
        arrays = []
        maps = [(one.map_id, str(one.revision), len(model)) for one, model in found]
        size = sum(count for _, _, count in maps)
        if found:
            entries = index.entries([model for _, model in found])
            arrays.append(entries.of_places(np.arange(len(entries))))
        stay = []
        for entries, part in sorted(opened.parts, key=lambda one: len(one[0])):
            kept = [one for one in part.maps if _is_live(one, live)]
            alive = sum(one.end - one.start for one in kept)
            is_small = alive <= _SMALLER * size and alive + size <= _MOST_JOINED
            if alive >= (1.0 - _MOST_DEAD) * len(entries) and not is_small:
                stay.append(part.model_copy(update={"maps": kept}))
            elif kept:
                kept = sorted(kept, key=lambda one: one.start)
                arrays.append(entries.of_places(_all_of(kept)))
                maps += [(one.map_id, one.revision, one.end - one.start) for one in kept]
                size += alive
        if arrays:
            joined = index.listed(
                {name: np.concatenate([one[name] for one in arrays]) for name in arrays[0]}
            )
            ends = np.cumsum([count for _, _, count in maps]).tolist()
            listed = [
                IndexedMap(map_id=map_id, revision=revision, start=end - count, end=end)
                for (map_id, revision, count), end in zip(maps, ends, strict=True)
            ]
            stay.append(Part(folder=files.write("part", joined.arrays()), maps=listed))
        if stay != manifest.parts:
            files.replace(manifest.model_copy(update={"parts": stay}))

    def _models(self, maps: Iterable[LiveMap]) -> Iterator[tuple[LiveMap, Model]]:
        """Yield the models of maps; one that cannot be read is left out, and opened by queries."""
        for one in maps:
            if self._stopping:
                return
            path = self._store.layout.revisions(one.map_id) / one.file_name
            try:
                yield one, read_revision(path, str(one.revision)).model
            except (CorruptFile, OSError) as error:
                _log.info("map %s is not indexed: %s", one.slug, error)


def _is_live(one: IndexedMap, live: Mapping[str, LiveMap]) -> bool:
    return one.map_id in live and live[one.map_id].revision == one.revision
