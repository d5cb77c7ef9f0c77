"""The indexes of the places of all maps of shared bases, kept up to date."""

import logging
import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from app.ending import end
from app.localization.open_index import OpenIndex, spans_of_maps
from core.encodings.model import Model
from core.errors import InvalidMap, TensorMapError
from storage.catalog import MapSummary
from storage.errors import BasisNotFound, CorruptFile
from storage.files.map_file import read_revision
from storage.files.place_files import VERSION, IndexedMap, Manifest, PlaceFiles
from storage.store import Store

FEWEST_MAPS = 9
"""Fewest maps of one basis that are indexed: fewer are opened, and stay open."""

_AT_ONCE = 20_000  # places that are read before their part is written, 2.5 kB each
_MOST_DEAD = 0.25  # of the places of a part
_SMALLER = 4  # a part that is not so many times larger than a new one is joined with it
_MOST_JOINED = 100_000  # places: a part is made in memory, 2.5 kB each
_ATTEMPTS = 3
_RETRY_S = 60.0  # after an update that failed, as on a full disk: each reads all missing maps
_CHECKED_FOR_S = 86_400.0  # after which every part is read to its end again

_log = logging.getLogger("tensormap.localization")


class PlaceIndexes:
    """The indexes of all shared bases; a thread of its own brings them up to date.

    Requests open them and read what the thread notes of each basis: the dictionaries and sets that
    both use are changed by one operation at a time, and what one of them misses, the next sees.

    Args:
        store: The store with the bases and revisions.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._open: dict[str, tuple[tuple[int, int], OpenIndex | None]] = {}
        self._checked: dict[str, set[str]] = {}  # by basis: folders of undamaged parts
        self._reported: set[str] = set()  # bases whose index broke a search since it was checked
        self._left_out: set[tuple[str, str | None]] = set()
        self._pending: set[str] = set()
        self._failed_s: dict[str, float] = {}  # by basis, when its last update failed
        self._changed = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._loop, name="place indexes", daemon=True)

    def start(self) -> None:
        """Bring all indexes up to date, then those that `wake` names; remove those of no basis.

        Each is checked once after a start and once a day.
        """
        bases = self._bases()
        if self._store.layout.index.exists():
            for folder in self._store.layout.index.iterdir():
                if folder.name not in bases:
                    PlaceFiles(folder).remove()
        self._thread.start()
        for basis in bases:
            self.wake(basis)

    def _bases(self) -> set[str]:
        of_maps = self._store.catalog.map_summaries.all()
        return {summary.basis for summary in of_maps if summary.basis is not None}

    def stop(self) -> None:
        """Stop after the maps that are being read, unless their disk hangs."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        end(self._thread)

    def wake(self, basis: str, missing: Iterable[MapSummary] | None = None) -> None:
        """Bring the index of a basis up to date soon.

        Args:
            basis: Digest of the basis.
            missing: Maps that are not in it: if each was left out when it was read, nothing is
                done, nor within a minute after an update that failed. A restart reads them again,
                and so does an update for another map.
        """
        if missing is not None and (
            self._failed_lately(basis) or all(map(self._is_left_out, missing))
        ):
            return
        with self._changed:
            self._pending.add(basis)
            self._changed.notify()

    def report_damage(self, basis: str) -> None:
        """Check an index soon that broke a search: damaged parts are made again."""
        self._reported.add(basis)
        self.wake(basis)

    def _failed_lately(self, basis: str) -> bool:
        return time.monotonic() - self._failed_s.get(basis, -math.inf) < _RETRY_S

    def _is_left_out(self, summary: MapSummary) -> bool:
        return (summary.map_id, summary.revision) in self._left_out

    def open(self, basis: str) -> OpenIndex | None:
        """Return the index of a basis, `None` if there is none that can be read."""
        files, failed = self._files(basis), None
        for _ in range(_ATTEMPTS):
            written = files.written()
            if written is None:
                self._open.pop(basis, None)
                return None
            known = self._open.get(basis)
            if known is not None and known[0] == written:
                return known[1]
            try:
                manifest = files.manifest()
                if manifest is None:
                    raise InvalidMap("the index has no manifest")
                opened = self._read(basis, files, manifest)
            except (OSError, ValueError, TypeError, InvalidMap, TensorMapError):
                failed = written  # replaced meanwhile, or damaged: then it is made again
                continue
            self._open[basis] = written, opened
            return opened
        if failed is not None:
            self._open[basis] = failed, None  # until another one is written
        _log.warning(
            "the index of basis %s cannot be read: what is damaged is made again", basis[:12]
        )
        return None

    def _read(self, basis: str, files: PlaceFiles, manifest: Manifest) -> OpenIndex:
        of_maps = self._store.bases.read(basis)
        kind = of_maps.parameters.encoder.place_index()
        if kind is None:
            raise InvalidMap(f"{of_maps.parameters.encoding} maps have no index")
        index = kind.of(of_maps)
        parts = tuple((index.read(files.read(part.folder)), part) for part in manifest.parts)
        for entries, part in parts:
            if max((indexed.end for indexed in part.maps), default=0) > len(entries):
                raise InvalidMap(f"{part.folder} has {len(entries)} places, its maps have more")
        return OpenIndex(
            of_maps,
            index,
            parts,
            {
                indexed.map_id: (number, indexed)
                for number, (_, part) in enumerate(parts)
                for indexed in part.maps
            },
        )

    def _files(self, basis: str) -> PlaceFiles:
        return PlaceFiles(self._store.layout.index / basis)

    def _loop(self) -> None:
        all_at_s = time.monotonic() + _CHECKED_FOR_S
        while True:
            with self._changed:
                left_s = max(0.0, all_at_s - time.monotonic())
                self._changed.wait_for(lambda: self._pending or self._stopping, left_s)
                if self._stopping:
                    return
                basis = self._pending.pop() if self._pending else None
            try:
                if basis is not None:
                    self.update(basis)
                    self._failed_s.pop(basis, None)
                    continue
                all_at_s = time.monotonic() + _CHECKED_FOR_S
                self._checked.clear()
                for known in {*self._bases(), *self._open}:  # open ones may be of deleted bases
                    self.wake(known)
            except Exception:  # noqa: BLE001 - other bases need the thread, and this one tries again
                named = "all bases"
                if basis is not None:
                    self._failed_s[basis] = time.monotonic()
                    named = f"basis {basis[:12]}"
                _log.exception("the index of %s cannot be brought up to date", named)

    def update(self, basis: str) -> None:
        """Add the maps that an index lacks, and remove those that are not live; others stay.

        Of two processes one does it.

        Raises:
            StorageFull: If no space is left.
        """
        files = self._files(basis)
        live = {
            summary.map_id: summary
            for summary in self._store.catalog.map_summaries.all()
            if summary.basis == basis and summary.revision is not None
        }
        if len(live) < FEWEST_MAPS:
            files.remove()
            self._open.pop(basis, None)  # which holds its files, and so their space
            self._checked.pop(basis, None)
            self._reported.discard(basis)
            return
        with files.locked() as alone:
            if alone:
                with suppress(BasisNotFound):  # deleted meanwhile
                    self._update(basis, files, live)

    def _update(self, basis: str, files: PlaceFiles, live: Mapping[str, MapSummary]) -> None:
        if self._store.bases.read(basis).parameters.encoder.place_index() is None:
            return
        reported = basis in self._reported
        self._reported.discard(basis)  # before it is checked: what is reported from now on is later
        if reported or self.open(basis) is None:
            self._checked.pop(basis, None)  # a part was damaged since, or there is no index
        empty = Manifest(version=VERSION, parts=[])
        found = files.manifest() or empty
        manifest = self._without_damaged_parts(basis, files, found)
        if manifest != found:
            files.replace(manifest)  # the maps of those are opened until they are indexed again
        if self.open(basis) is None:  # although each file is as it was written
            manifest = empty
        indexed = {
            of_map.map_id
            for part in manifest.parts
            for of_map in part.maps
            if _is_live(of_map, live)
        }
        missing = [summary for summary in live.values() if summary.map_id not in indexed]
        for maps in _batches(missing):
            manifest = self._with(maps, self._read(basis, files, manifest), manifest, files, live)
            if self._stopping:
                return
            if manifest != files.manifest():
                files.replace(manifest)

    def _without_damaged_parts(self, basis: str, files: PlaceFiles, manifest: Manifest) -> Manifest:
        """Return a manifest without damaged parts; those that were checked are not read again."""
        before, checked = self._checked.get(basis, set()), set()
        for part in manifest.parts:
            if self._stopping:
                return manifest
            if part.folder in before or files.matches_checksums(part):
                checked.add(part.folder)
            else:
                _log.warning(
                    "%s of the index of basis %s is damaged: its %d maps are indexed again",
                    part.folder,
                    basis[:12],
                    len(part.maps),
                )
        self._checked[basis] = checked
        parts = [part for part in manifest.parts if part.folder in checked]
        return manifest.model_copy(update={"parts": parts})

    def _with(
        self,
        added: Sequence[MapSummary],
        opened: OpenIndex,
        manifest: Manifest,
        files: PlaceFiles,
        live: Mapping[str, MapSummary],
    ) -> Manifest:
        """Write some maps to a part of their own, joined with parts that are small or mostly gone.

        Returns:
            The index with that part.
        """
        index = opened.index
        of_maps = []
        maps: list[tuple[str, str, int]] = []
        for summary, model in self._models(added):
            entries = index.entries([model])
            of_maps.append(entries)
            maps.append((summary.map_id, str(summary.revision), len(entries)))
        size = sum(count for _, _, count in maps)
        stay = []
        for entries, part in sorted(opened.parts, key=lambda part: len(part[0])):
            kept = [indexed for indexed in part.maps if _is_live(indexed, live)]
            alive = sum(indexed.end - indexed.start for indexed in kept)
            is_small = alive <= _SMALLER * size and alive + size <= _MOST_JOINED
            if alive >= (1.0 - _MOST_DEAD) * len(entries) and not is_small:
                stay.append(part.model_copy(update={"maps": kept}))
            elif kept and files.matches_checksums(part):
                # Else its maps are missing, and made again.
                kept = sorted(kept, key=lambda indexed: indexed.start)
                of_maps.append(entries.select(spans_of_maps(kept)))
                maps += [(old.map_id, old.revision, old.end - old.start) for old in kept]
                size += alive
        if of_maps:
            joined = index.joined(of_maps)
            ends = np.cumsum([count for _, _, count in maps]).tolist()
            listed = [
                IndexedMap(map_id=map_id, revision=revision, start=end - count, end=end)
                for (map_id, revision, count), end in zip(maps, ends, strict=True)
            ]
            stay.append(files.write(joined.arrays(), listed))
        return manifest.model_copy(update={"parts": stay})

    def _models(self, maps: Iterable[MapSummary]) -> Iterator[tuple[MapSummary, Model]]:
        """Yield the models of maps; one that cannot be read is left out, and opened by queries."""
        for summary in maps:
            if self._stopping:
                return
            path = self._store.layout.revisions(summary.map_id) / summary.file_name
            try:
                model = read_revision(path, str(summary.revision)).model
            except (CorruptFile, OSError) as error:
                self._left_out.add((summary.map_id, summary.revision))
                _log.info("map %s is not indexed: %s", summary.slug, error)
            else:
                self._left_out.discard((summary.map_id, summary.revision))
                yield summary, model


def _is_live(indexed: IndexedMap, live: Mapping[str, MapSummary]) -> bool:
    return indexed.map_id in live and live[indexed.map_id].revision == indexed.revision


def _batches(maps: Sequence[MapSummary]) -> list[list[MapSummary]]:
    """Return the maps that are read at once; one batch, without maps, if there are none."""
    batches: list[list[MapSummary]] = [[]]
    for summary in maps:
        if batches[-1] and sum(read.scans for read in batches[-1]) + summary.scans > _AT_ONCE:
            batches.append([])
        batches[-1].append(summary)
    return batches
