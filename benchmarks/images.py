"""Any number of range images that are cheap to compute."""

import numpy as np

from core.arrays import Float32Array
from core.scans.sensor import AngularGrid


class GeneratedImages:
    """`scans` images made when they are read: a street that drifts by, and noise; never kept."""

    def __init__(self, scans: int, seed: int = 0) -> None:
        self.grid = AngularGrid()
        self._scans = scans
        rng = np.random.default_rng(seed)
        rows, columns = self.grid.shape
        self._street = rng.gamma(2.0, 8.0, size=(rows, 8 * columns)).astype(np.float32)
        self._noise = rng.normal(scale=0.5, size=(64, rows, columns)).astype(np.float32)

    def __len__(self) -> int:
        return self._scans

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`."""
        columns = self.grid.columns
        shifts = np.arange(start, stop) % (7 * columns)
        images = np.stack([self._street[:, shift : shift + columns] for shift in shifts.tolist()])
        images += self._noise[np.arange(start, stop) % len(self._noise)]
        np.maximum(images, 0.0, out=images)
        return images
