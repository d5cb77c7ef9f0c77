"""Small images: a height image in one byte a cell, one column a sector, seen from any place.

A map of any views keeps one of each scan, to compare the best candidates of a scan query cell by
cell (docs/decisions/0031-verification-of-scan-queries.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray
from core.projection.visibility import SECTORS

STEPS_A_ROOT_METRE = 64.0
"""Heights are kept as square roots: low cells differ as much as high ones; 15.9 m is a byte."""
_MOST = 255


def sector_starts(columns: int) -> IntArray:
    """Return the first of J columns in each sector, `(60,)`; below 60, one is in several.

    Examples:
        >>> sector_starts(360)[:3].tolist(), sector_starts(40)[:4].tolist()
        ([0, 6, 12], [0, 1, 2, 2])
    """
    return np.minimum(-(-np.arange(SECTORS) * columns // SECTORS), columns - 1)


def small_image(cells: Float32Array) -> NDArray[np.uint8]:
    """Return 64 times the square root of the greatest height in each sector, `(..., I, 60)`.

    Args:
        cells: `(..., I, J)` of height images; what is below 0 is hidden and becomes 0.

    Examples:
        >>> cells = np.zeros((1, 360), np.float32)
        >>> cells[0, [5, 6, 359]] = 1.0, 4.0, 100.0
        >>> small_image(cells)[0, [0, 1, 2, 59]].tolist()
        [64, 128, 0, 255]
    """
    starts = sector_starts(cells.shape[-1])
    highest = np.maximum.reduceat(np.maximum(cells, 0.0), starts, axis=-1)
    roots = STEPS_A_ROOT_METRE * np.sqrt(highest, dtype=np.float64)
    return np.minimum(np.rint(roots), _MOST).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class DisplacedView:
    """From small images to those of places beside, between cells: nearest returns do not move.

    Attributes:
        corners: `(4, V, I, 60)` the cells between which each cell of a place is, flat.
        weights: `(4, V, I, 60)` their shares of it.
    """

    corners: IntArray
    weights: Float32Array

    @classmethod
    def at(
        cls, rings: int, ring_m: float, columns: int, ahead_m: FloatArray, left_m: FloatArray
    ) -> "DisplacedView":
        """Return the view from some places.

        Args:
            rings: I.
            ring_m: How wide a ring is.
            columns: J of the images that the small ones were made of.
            ahead_m: How far ahead of the scans each place is, `(V,)`.
            left_m: How far to the left, `(V,)`.
        """
        step = 2.0 * np.pi / SECTORS
        first = 0.5 * step - np.pi / columns  # the middle of sector 0; column 0 of J is at 0
        azimuth = first + step * np.arange(SECTORS)
        distance_m = ring_m * (0.5 + np.arange(rings))
        x_m = np.multiply.outer(distance_m, np.cos(azimuth)) + ahead_m[:, None, None]
        y_m = np.multiply.outer(distance_m, np.sin(azimuth)) + left_m[:, None, None]
        ring = np.hypot(x_m, y_m) / ring_m - 0.5
        sector = (np.arctan2(y_m, x_m) - first) / step
        in_ring, in_sector = np.floor(ring), np.floor(sector)
        rows = in_ring.astype(np.int64), in_ring.astype(np.int64) + 1
        inside = [(row >= 0) & (row < rings) for row in rows]
        sides = [(in_sector.astype(np.int64) + beside) % SECTORS for beside in (0, 1)]
        of_row = inside[0] * (1.0 - (ring - in_ring)), inside[1] * (ring - in_ring)
        of_side = 1.0 - (sector - in_sector), sector - in_sector
        corners: list[IntArray] = []
        weights: list[FloatArray] = []
        for beyond in (0, 1):
            for beside in (0, 1):
                cell = rows[beyond] * SECTORS + sides[beside]
                corners.append(np.where(inside[beyond], cell, 0))
                weights.append(of_row[beyond] * of_side[beside])
        return cls(np.array(corners), np.array(weights, np.float32))

    @classmethod
    def concatenate(cls, views: Sequence["DisplacedView"]) -> "DisplacedView":
        """Return the view from the places of all of these, which are of one grid."""
        corners = np.concatenate([view.corners for view in views], axis=1)
        return cls(corners, np.concatenate([view.weights for view in views], axis=1))

    def of(self, small: NDArray[Any]) -> Float32Array:
        """Return what `(n, I, 60)` small images are from each place, `(n, V, I, 60)`."""
        cells = small.reshape(len(small), -1).astype(np.float32)
        # All corners are in the image: clipping takes half the time of looking whether they are.
        seen = cells.take(self.corners.reshape(4, -1), axis=1, mode="clip")
        seen *= self.weights.reshape(4, -1)
        return np.asarray(seen.sum(axis=1).reshape(len(small), *self.corners.shape[1:]))
