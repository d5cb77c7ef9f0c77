"""An index of the places of all maps of a shared basis, as it is searched."""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import IntArray
from core.encodings.basis import Basis
from core.encodings.place_index import PlaceEntries, PlaceIndex
from core.encodings.signature import Signature
from core.errors import InvalidSignature
from core.projection.imager import Image
from storage.catalog import MapSummary
from storage.files.place_files import IndexedMap, Part


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

    def has(self, one: MapSummary) -> bool:
        """Return whether the live revision of a map is indexed."""
        found = self.places_of.get(one.map_id)
        return found is not None and found[1].revision == one.revision

    def nearest_maps(
        self,
        maps: Sequence[MapSummary],
        query: Sequence[Signature] | Image,
    ) -> list[str]:
        """Return the ids of the maps that a query may be of, the most likely first.

        Args:
            maps: Those that may be found, all of them indexed.
            query: One signature of this basis, or an image on its grid.

        Raises:
            InvalidSignature: If it is not of this basis, or there are several.
        """
        asked = query if isinstance(query, Image) else self._required(query)
        of_part: dict[int, list[IndexedMap]] = {}
        for one in maps:
            number, indexed = self.places_of[one.map_id]
            of_part.setdefault(number, []).append(indexed)
        searched = []
        for number, spans in sorted(of_part.items()):
            entries, part = self.parts[number]
            ranges = None if len(spans) == len(part.maps) else spans_of_maps(spans)
            searched.append((part, (entries, ranges)))
        compared = self.index.nearest(asked, [one for _, one in searched])
        nearest: dict[str, float] = {}
        for (part, _), (places, distances) in zip(searched, compared, strict=True):
            starts = [one.start for one in part.maps]
            for place, distance in zip(places.tolist(), distances.tolist(), strict=True):
                of_it = part.maps[bisect_right(starts, place) - 1]
                if of_it.start <= place < of_it.end:  # else its map is gone
                    nearest[of_it.map_id] = min(distance, nearest.get(of_it.map_id, np.inf))
        return sorted(nearest, key=lambda map_id: nearest[map_id])

    def _required(self, signatures: Sequence[Signature]) -> Signature:
        """Return the signature if it is one that the basis makes."""
        parameters = self.basis.parameters
        encodings = [one.encoding for one in signatures]
        if encodings != [parameters.encoding]:
            raise InvalidSignature(
                f"{len(encodings)} signatures came ({', '.join(map(str, encodings))}), wanted one"
                f" {parameters.encoding} signature"
            )
        parameters.encoder.require_shape(signatures[0].values.shape, parameters)
        return signatures[0]


def spans_of_maps(spans: Iterable[IndexedMap]) -> IntArray:
    """Return the ranges of the places of some maps of one part, `(n, 2)`, rising.

    Maps that follow one another are one range.

    Examples:
        >>> of = [IndexedMap(map_id="", revision="", start=n, end=n + 5) for n in (20, 0, 5)]
        >>> spans_of_maps(of).tolist()
        [[0, 10], [20, 25]]
    """
    merged: list[list[int]] = []
    for start, end in sorted((one.start, one.end) for one in spans):
        if merged and merged[-1][1] == start:
            merged[-1][1] = end
        else:
            merged.append([start, end])
    return np.array(merged, np.int64).reshape(-1, 2)
