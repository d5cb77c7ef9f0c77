"""An index of the places of all maps of a shared basis, as it is searched."""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from app.localization.derived import Derived
from core.arrays import IntArray
from core.encodings.basis import Basis
from core.encodings.place_index import PlaceEntries, PlaceIndex
from core.encodings.signature import Signature
from core.errors import InvalidSignature
from core.projection.imager import Image
from storage.catalog import MapSummary
from storage.files.place_files import IndexedMap, Part

_Parts = tuple[tuple[PlaceEntries, Part], ...]
_PlacesOf = Mapping[str, tuple[int, IndexedMap]]


@dataclass(frozen=True, eq=False)
class _SearchedPart:
    """The maps of a part that a query may be of.

    Attributes:
        entries: All its places.
        ranges: The ranges of the maps' places, `(n, 2)`, rising; `None` if they are all.
        maps: The maps in the order of their places.
        starts: The maps' first places.
    """

    entries: PlaceEntries
    ranges: IntArray | None
    maps: Sequence[IndexedMap]
    starts: Sequence[int]


@dataclass(frozen=True, eq=False)
class OpenIndex:
    """An index whose files are mapped into memory.

    Attributes:
        basis: The basis of the index's maps.
        index: How it is searched.
        parts: Each part's entries and maps.
        places_of: Part and places of each map by its id.
    """

    basis: Basis
    index: PlaceIndex[Any]
    parts: _Parts
    places_of: _PlacesOf
    _derived: Derived = field(default_factory=Derived, init=False)

    def split(self, maps: Sequence[MapSummary]) -> tuple[list[MapSummary], list[MapSummary]]:
        """Return the maps whose live revision is indexed, and the others."""
        return self._derived.of(_split, self.places_of, maps)

    def count_places(self, maps: Sequence[MapSummary], without: Sequence[MapSummary]) -> int:
        """Return how many places some indexed maps have, without those of a few of them."""
        of_all = self._derived.of(_count_places, self.places_of, maps)
        return of_all - _count_places(self.places_of, without)

    def nearest_maps(
        self,
        maps: Sequence[MapSummary],
        query: Sequence[Signature] | Image,
    ) -> list[MapSummary]:
        """Return the maps that a query may be of, the most likely first.

        Args:
            maps: The maps that may be found, all of them indexed.
            query: One signature of this basis, or an image on its grid.

        Raises:
            InvalidSignature: If it is not of this basis, or there are several.
        """
        asked = query if isinstance(query, Image) else self._required(query)
        searched = self._derived.of(_searched_parts, self.parts, self.places_of, maps)
        compared = self.index.nearest(asked, [(part.entries, part.ranges) for part in searched])
        nearest: dict[str, float] = {}
        for of_part, (places, distances) in zip(searched, compared, strict=True):
            for place, distance in zip(places.tolist(), distances.tolist(), strict=True):
                found = of_part.maps[bisect_right(of_part.starts, place) - 1]
                if found.start <= place < found.end:  # else its map is gone
                    map_id = found.map_id
                    nearest[map_id] = min(distance, nearest.get(map_id, np.inf))
        by_id = self._derived.of(_by_id, maps)
        return [by_id[map_id] for map_id in sorted(nearest, key=nearest.__getitem__)]

    def _required(self, signatures: Sequence[Signature]) -> Signature:
        """Return the signature if it is one that the basis makes."""
        parameters = self.basis.parameters
        encodings = [signature.encoding for signature in signatures]
        if encodings != [parameters.encoding]:
            raise InvalidSignature(
                f"wanted one {parameters.encoding} signature, got {len(encodings)}"
                f" ({', '.join(map(str, encodings))})"
            )
        parameters.encoder.require_shape(signatures[0].values.shape, parameters)
        return signatures[0]


def _split(
    places_of: _PlacesOf, maps: Sequence[MapSummary]
) -> tuple[list[MapSummary], list[MapSummary]]:
    """Return the maps whose live revision has places, and the others."""
    split: tuple[list[MapSummary], list[MapSummary]] = [], []
    for summary in maps:
        found = places_of.get(summary.map_id)
        is_indexed = found is not None and found[1].revision == summary.revision
        split[not is_indexed].append(summary)
    return split


def _count_places(places_of: _PlacesOf, maps: Sequence[MapSummary]) -> int:
    indexed = [places_of[summary.map_id][1] for summary in maps]
    return sum(of_map.end - of_map.start for of_map in indexed)


def _searched_parts(
    parts: _Parts, places_of: _PlacesOf, maps: Sequence[MapSummary]
) -> list[_SearchedPart]:
    """Return the parts that some maps are in, and their places there."""
    of_part: dict[int, list[IndexedMap]] = {}
    for summary in maps:
        number, indexed = places_of[summary.map_id]
        of_part.setdefault(number, []).append(indexed)
    found = []
    for number, indexed_maps in sorted(of_part.items()):
        entries, part = parts[number]
        indexed_maps.sort(key=lambda indexed: indexed.start)
        ranges = None if len(indexed_maps) == len(part.maps) else spans_of_maps(indexed_maps)
        starts = [indexed.start for indexed in indexed_maps]
        found.append(_SearchedPart(entries, ranges, indexed_maps, starts))
    return found


def _by_id(maps: Sequence[MapSummary]) -> dict[str, MapSummary]:
    return {summary.map_id: summary for summary in maps}


def spans_of_maps(spans: Iterable[IndexedMap]) -> IntArray:
    """Return the ranges of the places of some maps of one part, `(n, 2)`, rising.

    Maps that follow one another are one range.

    Examples:
        >>> maps = [IndexedMap(map_id="", revision="", start=n, end=n + 5) for n in (20, 0, 5)]
        >>> spans_of_maps(maps).tolist()
        [[0, 10], [20, 25]]
    """
    merged: list[list[int]] = []
    for start, end in sorted((span.start, span.end) for span in spans):
        if merged and merged[-1][1] == start:
            merged[-1][1] = end
        else:
            merged.append([start, end])
    return np.array(merged, np.int64).reshape(-1, 2)
