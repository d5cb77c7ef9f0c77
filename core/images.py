"""Where a build reads its images from, as often as it needs them."""

from typing import Protocol

from core.arrays import Float32Array, IntArray, frozen
from core.errors import InvalidImage
from core.sensor import AngularGrid

__all__ = ["ImageSource", "MemoryImages", "SelectedImages"]


class ImageSource(Protocol):
    """Range images on one grid, in the order of the map's scans.

    A build reads them twice, block by block, so that it never holds them all.
    """

    @property
    def grid(self) -> AngularGrid:
        """The lattice of every image."""

    def __len__(self) -> int:
        """Return how many images there are."""

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`, `(stop - start, I, J)` float32 metres."""


class MemoryImages:
    """Images held in memory, `(n, I, J)`."""

    def __init__(self, ranges_m: Float32Array, grid: AngularGrid) -> None:
        if ranges_m.ndim != 3 or ranges_m.shape[1:] != grid.shape:
            raise InvalidImage(f"images have shape {ranges_m.shape[1:]}, the grid {grid.shape}")
        self.grid = grid
        self._ranges_m: Float32Array = frozen(ranges_m, "float32")

    def __len__(self) -> int:
        return len(self._ranges_m)

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`."""
        return self._ranges_m[start:stop]


class SelectedImages:
    """Some rows of another source, in a rising order."""

    def __init__(self, source: ImageSource, rows: IntArray) -> None:
        self.grid = source.grid
        self._source = source
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows)

    def read(self, start: int, stop: int) -> Float32Array:
        """Return selected images `start` up to `stop`."""
        rows = self._rows[start:stop]
        if not len(rows):
            return self._source.read(0, 0)
        first = int(rows[0])
        return self._source.read(first, int(rows[-1]) + 1)[rows - first]
