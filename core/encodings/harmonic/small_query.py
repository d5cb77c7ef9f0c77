"""A query's small image, correlated with those of scans in some headings."""

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

    def correlation(self, views: Float32Array, seen: BoolArray, headings: IntArray) -> Float32Array:
        """Return the correlation in some headings of each scan, `(n, V, H)`.

        Args:
            views: `(n, V, I, 60)` small images of scans, each from several places.
            seen: `(n, 60)` the sectors that the scans see.
            headings: `(n, H)` by how many sectors, 6 degrees each, the query is turned.
        """
        of_map = seen.astype(np.float32)
        scans, places, _, sectors = views.shape
        masked = np.empty((scans, places, self._rings, sectors), np.float32)
        views = np.multiply(views[:, :, : self._rings], of_map[:, None, None], out=masked)
        of_seen = np.swapaxes(self._seen[headings], 1, 2)
        cells = np.maximum(self._rings * (of_map[:, None] @ of_seen), _LEAST_CELLS)
        mean = np.take_along_axis(of_map @ self._sums.T, headings, 1)[:, None] / cells
        of_mean = views.sum(axis=2) @ of_seen / cells
        squares = np.take_along_axis(of_map @ self._squares.T, headings, 1)[:, None]
        variance = squares / cells - mean * mean
        of_variance = np.square(views).sum(axis=2) @ of_seen / cells - of_mean * of_mean
        turned = np.swapaxes(self._images[headings], 1, 2)
        both = views.reshape(scans, places, -1) @ turned / cells - mean * of_mean
        variance = np.maximum(variance, _LEAST_VARIANCE) * np.maximum(of_variance, _LEAST_VARIANCE)
        return np.asarray(both / np.sqrt(variance))
