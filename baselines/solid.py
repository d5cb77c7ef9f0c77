"""SOLiD (Kim et al., RA-L 2024): how many returns at each range and azimuth, weighted by elevation.

Re-derived from the paper's description. Returns, thinned to one in each cube of 0.5 m, are counted
in bins of range and elevation and in bins of azimuth and elevation. Elevations are weighted by how
many returns they have, scaled to 0..1: the two products with that weight are the descriptor, one
for places, one for the heading. What the paper leaves open, and what is done here: the elevations
are those of the sensor's grid, and returns outside them or beyond reach are left out; a return on
the edge of two bins is in the upper one; if all elevations have equally many returns all weigh 1.
The authors publish other values for an HDL-64E, `PROFILES`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.descriptor import PlaceDescriptor, Places, relative_yaw_deg
from baselines.voxels import voxel_means
from core.arrays import Float32Array, FloatArray, IntArray
from core.errors import InvalidParameters, InvalidScan
from core.evaluation.methods import Nearest
from core.numbers import require_above, require_at_least
from core.scans.scan import Scan


@dataclass(frozen=True)
class Solid(PlaceDescriptor):
    """The descriptor: N_r numbers for the place, then N_a for the heading.

    Attributes:
        ranges: N_r, bins of horizontal range.
        azimuths: N_a.
        elevations: N_e.
        reach_m: Returns beyond it are left out.
        elevation_min_deg: The lowest elevation that the sensor sees.
        elevation_max_deg: The highest.
        voxel_m: Side of the cubes that returns are thinned to; 0 keeps all of them.
        min_range_m: Returns nearer than that are left out.
        clamped: Returns outside the elevations are in the lowest or highest bin, not left out.
    """

    name = "solid"

    ranges: int = 40
    azimuths: int = 60
    elevations: int = 64
    reach_m: float = 80.0
    elevation_min_deg: float = -25.5
    elevation_max_deg: float = 4.5
    voxel_m: float = 0.5
    min_range_m: float = 0.0
    clamped: bool = False

    def __post_init__(self) -> None:
        require_at_least(1, ranges=self.ranges, azimuths=self.azimuths, elevations=self.elevations)
        require_above(0, reach_m=self.reach_m)
        require_at_least(0, voxel_m=self.voxel_m, min_range_m=self.min_range_m)
        if not -90.0 <= self.elevation_min_deg < self.elevation_max_deg <= 90.0:
            raise InvalidParameters(
                f"elevations {self.elevation_min_deg}..{self.elevation_max_deg} do not rise"
                " within -90..90"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """`(N_r + N_a,)`."""
        return (self.ranges + self.azimuths,)

    def describe(self, scan: Scan) -> Float32Array:
        """Return what is for places and what is for headings, one after the other.

        Raises:
            InvalidScan: If no return is within reach and the elevations.
        """
        returns = scan.points_m
        if self.min_range_m:
            returns = returns[np.linalg.norm(returns, axis=1) >= self.min_range_m]
            if not len(returns):
                raise InvalidScan(
                    f"none of the {len(scan)} returns is {self.min_range_m:g} m away or more"
                )
        points = voxel_means(returns, self.voxel_m) if self.voxel_m else returns
        x, y, z = points.T.astype(np.float64)
        range_m = np.sqrt(x * x + y * y)
        elevation_deg = np.degrees(np.arctan2(z, range_m))
        step_deg = (self.elevation_max_deg - self.elevation_min_deg) / self.elevations
        range_bin = np.floor(range_m * (self.ranges / self.reach_m))
        elevation_bin = np.floor((elevation_deg - self.elevation_min_deg) / step_deg)
        if self.clamped:
            elevation_bin = np.clip(elevation_bin, 0, self.elevations - 1)
        inside = range_bin < self.ranges
        inside &= (elevation_bin >= 0) & (elevation_bin < self.elevations)
        if not inside.any():
            raise InvalidScan(
                f"none of the {len(scan)} returns is within {self.reach_m:g} m and"
                f" {self.elevation_min_deg:g}..{self.elevation_max_deg:g} deg of elevation"
            )
        azimuth = np.arctan2(y[inside], x[inside]) / (2.0 * np.pi) % 1.0
        azimuth_bin = np.floor(azimuth * self.azimuths).astype(np.int64) % self.azimuths
        elevation = elevation_bin[inside].astype(np.int64)
        by_range = _counts(range_bin[inside].astype(np.int64), self.ranges, elevation, self)
        by_azimuth = _counts(azimuth_bin, self.azimuths, elevation, self)
        importance = by_range.sum(axis=0)
        spread = importance.max() - importance.min()
        if spread > 0:
            weight = (importance - importance.min()) / spread
        else:
            weight = np.ones(self.elevations)
        return np.concatenate([by_range @ weight, by_azimuth @ weight]).astype(np.float32)

    def places(self, descriptors: Float32Array) -> Places:
        """Return places to search."""
        return SolidPlaces(descriptors, self.ranges)


PROFILES: Mapping[str, Mapping[str, Any]] = {
    "hdl-64e": {
        "elevations": 32,
        "voxel_m": 0.4,
        "min_range_m": 3.0,
        "elevation_min_deg": -24.8,
        "elevation_max_deg": 2.0,
        "clamped": True,
    }
}
"""What the authors publish for a sensor: sparolab/SOLiD, `lidar_velodyne.yaml`."""


def _counts(first: IntArray, bins: int, elevation: IntArray, of: Solid) -> FloatArray:
    cells = first * of.elevations + elevation
    counts = np.bincount(cells, minlength=bins * of.elevations)
    return counts.reshape(bins, of.elevations).astype(np.float64)


class SolidPlaces(Places):
    """Places by the cosine of their ranges, headings by the least sum of absolute differences."""

    def __init__(self, descriptors: Float32Array, ranges: int) -> None:
        super().__init__(descriptors)
        self._ranges = ranges
        self._units = _unit(descriptors[:, :ranges])
        self._azimuths = descriptors[:, ranges:].astype(np.float64)

    def _nearest(self, descriptor: Float32Array, last: int) -> Nearest:
        """Return the place with the greatest cosine, and the turn to it."""
        distances = 1.0 - self._units[:last] @ _unit(descriptor[: self._ranges])
        row = int(distances.argmin())
        queried = descriptor[self._ranges :].astype(np.float64)
        sectors = len(queried)
        # Row s is the place's azimuths seen from a query that is turned by s sectors.
        shifted = self._azimuths[row][(np.arange(sectors)[:, None] + np.arange(sectors)) % sectors]
        shift = int(np.abs(shifted - queried).sum(axis=1).argmin())
        return Nearest(row, max(0.0, float(distances[row])), relative_yaw_deg(shift, sectors))


def _unit(vectors: Float32Array) -> FloatArray:
    norms = np.linalg.norm(vectors.astype(np.float64), axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(norms > 0, norms, 1.0))
