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
        self, maps: Sequence[MapSummary], signatures: Sequence[Signature]
    ) -> list[str]:
        """Return the ids of the maps that a signature may be of, the most likely first.

        Args:
            maps: Those that may be found, all of them indexed.
            signatures: One, of this basis.

        Raises:
            InvalidSignature: If it is not of this basis, or there are several.
        """
        signature = self._required(signatures)
        searched = []
        for number, (entries, part) in enumerate(self.parts):
            spans = [
                place
                for one in maps
                for of_part, place in [self.places_of[one.map_id]]
                if of_part == number
            ]
            if spans:
                places = None if len(spans) == len(part.maps) else places_of_maps(spans)
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


def places_of_maps(spans: Iterable[IndexedMap]) -> IntArray:
    """Return the places of some maps of one part, rising."""
    ordered = sorted((one.start, one.end) for one in spans)
    return np.concatenate([np.arange(start, end) for start, end in ordered])
