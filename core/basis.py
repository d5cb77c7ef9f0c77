"""What a vehicle downloads once to make signatures on board."""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, IntArray, frozen
from core.errors import InvalidMap, SensorMismatch
from core.parameters import MapParameters
from core.projection import RangeImage, project_scan
from core.scan import Scan
from core.signature import Signature

__all__ = ["Basis"]


@dataclass(frozen=True, eq=False)
class Basis:
    """The bases of some segments of one revision; no scan's place can be read from them.

    Attributes:
        revision: Digest of the map revision.
        parameters: How scans become images; grid, reducer and sensor.
        segments: `(S,)` which segments these are.
        elevation_basis: `(S, I, r1)` float32.
        azimuth_basis: `(S, J, r2)` float32.
    """

    revision: str
    parameters: MapParameters
    segments: IntArray
    elevation_basis: Float32Array
    azimuth_basis: Float32Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "segments", frozen(self.segments, np.int64))
        object.__setattr__(self, "elevation_basis", frozen(self.elevation_basis, np.float32))
        object.__setattr__(self, "azimuth_basis", frozen(self.azimuth_basis, np.float32))
        (rows, columns), (r1, r2) = self.parameters.grid.shape, self.parameters.ranks
        count = len(self.segments)
        if self.elevation_basis.shape != (count, rows, r1):
            raise InvalidMap(f"elevation_basis has shape {self.elevation_basis.shape}")
        if self.azimuth_basis.shape != (count, columns, r2):
            raise InvalidMap(f"azimuth_basis has shape {self.azimuth_basis.shape}")

    def image(self, scan: Scan) -> RangeImage:
        """Project a scan as the map's own scans were.

        Raises:
            InvalidScan: If no return falls inside the grid.
        """
        return project_scan(scan, self.parameters.grid, self.parameters.reducer)

    def encode(self, image: RangeImage) -> tuple[Signature, ...]:
        """Return the image's signature in each segment's bases (paper, sec. 2.3).

        Raises:
            SensorMismatch: If the image is on another grid.
        """
        self.require_grid(image)
        ranges = image.ranges_m.astype(np.float64)
        values = self.elevation_basis.transpose(0, 2, 1) @ ranges @ self.azimuth_basis
        return tuple(
            Signature(slice_.astype(np.float32), segment, self.revision)
            for slice_, segment in zip(values, self.segments.tolist(), strict=True)
        )

    def require_grid(self, image: RangeImage) -> None:
        """Raise `SensorMismatch` unless the image is on this map's grid."""
        if image.grid != self.parameters.grid:
            raise SensorMismatch(f"the image is on {image.grid}, the map on {self.parameters.grid}")
