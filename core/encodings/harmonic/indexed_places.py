"""The places of many maps as an index keeps them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.place_index import PlaceEntries

Int8Array = NDArray[np.int8]

RENDERINGS = 5
"""Renderings of a place that are indexed; of a place with fewer, some are indexed twice."""


@dataclass(frozen=True, eq=False)
class HarmonicPlaces(PlaceEntries):
    """The places of some maps, map after map.

    Attributes:
        codes: `(2 r2 - 1, r1, 5, n)` int8, as `SignatureCodes` of five renderings.
        scales: `(n, 5)` float32 of these.
        factors: `(c, 5, n)` float32 by which sums of their first numbers are multiplied to be like
            those of other renderings, for each of `compared_ranks`.
        hidden: `(n, 5)` int64, the sectors that each does not see.
        images: `(n, I, 60)` uint8 verification images, empty of a place without one; of a basis
            whose maps have none `(n, 0, 60)`.
    """

    codes: Int8Array
    scales: Float32Array
    factors: Float32Array
    hidden: IntArray
    images: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.scales)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return {
            "codes": self.codes,
            "scales": self.scales,
            "factors": self.factors,
            "hidden": self.hidden,
            "images": self.images,
        }

    def select(self, spans: IntArray) -> "HarmonicPlaces":
        """Return the places of some ranges."""
        if spans.tolist() == [[0, len(self)]]:
            return self
        return joined([self._slice(start, end) for start, end in spans.tolist()])

    def _slice(self, start: int, end: int) -> "HarmonicPlaces":
        block = slice(start, end)
        return HarmonicPlaces(
            self.codes[..., block],
            self.scales[block],
            self.factors[..., block],
            self.hidden[block],
            self.images[block],
        )


def joined(parts: Sequence[HarmonicPlaces]) -> HarmonicPlaces:
    """Return the places of some entries, one after another."""
    return HarmonicPlaces(
        np.concatenate([one.codes for one in parts], axis=-1),
        np.concatenate([one.scales for one in parts]),
        np.concatenate([one.factors for one in parts], axis=-1),
        np.concatenate([one.hidden for one in parts]),
        np.concatenate([one.images for one in parts]),
    )


def beside(lateral_offset_m: FloatArray) -> IntArray:
    """Return which of some viewpoints are indexed, `(5,)`, the third on the line.

    Beside it two on each side, as far as the map has them.
    """
    middle = int(np.abs(lateral_offset_m).argmin())
    return np.clip(middle + np.arange(-2, 3), 0, len(lateral_offset_m) - 1)
