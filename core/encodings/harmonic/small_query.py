"""A query's small image, correlated with those of scans in some headings."""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, Float32Array, IntArray
from core.projection.small_image import sector_starts, small_image
from core.projection.visibility import SECTORS

_LEAST_VARIANCE = 1.0  # of a cell: a step of a byte
_LEAST_CELLS = 1.0


class SmallQuery:
    """A query's small image in every heading.

    Cells that the query or the scan of the map does not see are left out, and so are the rings
    beyond the farthest return of the query: it may have seen no farther.

    Args:
        cells: `(I, J)` of the query's height image.
    """

    def __init__(self, cells: Float32Array) -> None:
        self._rings = 1 + int(np.flatnonzero((cells > 0).any(axis=1))[-1])
        seen = np.minimum.reduceat(cells[0] >= 0, sector_starts(cells.shape[-1]))
        small = small_image(cells[: self._rings]) * seen
        sector = np.arange(SECTORS)
        turned = (sector - sector[:, None]) % SECTORS  # row s: turned by s sectors
        self._seen = seen[turned].astype(np.float32)
        images = np.moveaxis(small[:, turned], 1, 0).astype(np.float32)
        self._images = images.reshape(SECTORS, -1)
        self._sums, self._squares = images.sum(axis=1), np.square(images).sum(axis=1)

    def in_headings(self, seen: BoolArray, headings: IntArray) -> "QueryInHeadings":
        """Return the query as it would be in some headings of each scan.

        Args:
            seen: `(n, 60)` the sectors that the scans see.
            headings: `(n, H)` by how many sectors, 6 degrees each, the query is turned.
        """
        of_map = seen.astype(np.float32)
        both_see = np.swapaxes(self._seen[headings] * of_map[:, None], 1, 2)
        cells = np.maximum(self._rings * both_see.sum(axis=1, keepdims=True), _LEAST_CELLS)
        mean = np.take_along_axis(of_map @ self._sums.T, headings, 1)[:, None] / cells
        squares = np.take_along_axis(of_map @ self._squares.T, headings, 1)[:, None]
        variance = np.maximum(squares / cells - mean * mean, _LEAST_VARIANCE)
        turned = self._images[headings].reshape(*headings.shape, self._rings, SECTORS)
        turned *= of_map[:, None, None]
        turned = np.swapaxes(turned.reshape(*headings.shape, -1), 1, 2)
        return QueryInHeadings(self._rings, both_see, cells, turned, mean, variance)

    def correlation(self, views: Float32Array, seen: BoolArray, headings: IntArray) -> Float32Array:
        """Return the correlation in some headings of each scan, `(n, V, H)`.

        Args:
            views: `(n, V, I, 60)` small images of scans, each from several places.
            seen: `(n, 60)` the sectors that the scans see.
            headings: `(n, H)` by how many sectors, 6 degrees each, the query is turned.
        """
        return self.in_headings(seen, headings).correlation(views)


@dataclass(frozen=True, eq=False)
class QueryInHeadings:
    """A query in some headings of each of n scans, of which it is compared with any views.

    Attributes:
        rings: How many are compared.
        both_see: `(n, 60, H)` 1 where the query and the scan see, else 0.
        cells: `(n, 1, H)` how many cells that are, at least 1.
        turned: `(n, rings * 60, H)` the query's image, 0 where the scan does not see.
        mean: `(n, 1, H)` of its cells where the scan sees.
        variance: `(n, 1, H)` the same.
    """

    rings: int
    both_see: Float32Array
    cells: Float32Array
    turned: Float32Array
    mean: Float32Array
    variance: Float32Array

    def correlation(self, views: Float32Array) -> Float32Array:
        """Return the correlation with each scan from each place in each heading, `(n, V, H)`.

        Args:
            views: `(n, V, I, 60)` small images of the scans, each from several places.
        """
        views = views[:, :, : self.rings]
        mean = np.einsum("nvis->nvs", views) @ self.both_see / self.cells
        # `square` and `sum` take twice as long.
        squares = np.einsum("nvis,nvis->nvs", views, views) @ self.both_see / self.cells
        variance = np.maximum(squares - mean * mean, _LEAST_VARIANCE)
        both = views.reshape(*views.shape[:2], -1) @ self.turned / self.cells - self.mean * mean
        return np.asarray(both / np.sqrt(self.variance * variance))
