"""M2DP (He, Wang and Zhang, IROS 2016): the returns' density on many planes through their centroid.

Re-derived from the paper's section III. Returns are moved to their centroid and turned to their
principal axes, projected onto p x q planes and counted there in l circles of t sectors; the first
left and right singular vectors of that `(p q, l t)` matrix are the descriptor. What the paper
leaves open, and what is done here: a principal axis has no sign, so that each of the first two
points to where the third moment along it is positive, and the third completes a right-handed frame;
normals have azimuths k pi / p and elevations k pi / 2q, k from 0; the x axis of a plane is the
projection of the first principal axis, or of the second where the first is the plane's normal; all
planes share the outer radius, the distance of the farthest return from the centroid; both singular
vectors have no negative sum (those of a matrix of counts have one sign); and returns are thinned to
one in each cube of 0.5 m, without which the dense ground beside the vehicle decides (decision 16).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from baselines.descriptor import PlaceDescriptor, Places
from baselines.voxels import voxel_means
from core.arrays import Float32Array, FloatArray
from core.errors import InvalidScan
from core.evaluation.methods import Nearest
from core.numbers import require_at_least
from core.scans.scan import Scan

_BLOCK = 8192  # returns that are projected at once: the intermediate arrays stay in the cache


@dataclass(frozen=True)
class M2dp(PlaceDescriptor):
    """The descriptor, with the paper's parameters as defaults: 64 + 128 = 192 numbers.

    Attributes:
        azimuths: p.
        elevations: q.
        circles: l, of radii r, 2^2 r, ... l^2 r.
        sectors: t.
        voxel_m: Side of cubes that returns are thinned to; 0 keeps all of them.
    """

    name = "m2dp"

    azimuths: int = 4
    elevations: int = 16
    circles: int = 8
    sectors: int = 16
    voxel_m: float = 0.5

    def __post_init__(self) -> None:
        require_at_least(1, azimuths=self.azimuths, elevations=self.elevations)
        require_at_least(1, circles=self.circles, sectors=self.sectors)
        require_at_least(0, voxel_m=self.voxel_m)

    @property
    def shape(self) -> tuple[int, ...]:
        """`(p q + l t,)`."""
        return (self.azimuths * self.elevations + self.circles * self.sectors,)

    @cached_property
    def _axes(self) -> Float32Array:
        """The two axes of every plane in the principal frame, `(2, 3, p q)`."""
        azimuth = np.pi * np.arange(self.azimuths) / self.azimuths
        elevation = 0.5 * np.pi * np.arange(self.elevations) / self.elevations
        azimuth, elevation = (a.ravel() for a in np.meshgrid(azimuth, elevation, indexing="ij"))
        across = np.cos(elevation)
        normals = np.stack(
            [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1
        )
        of_first = np.array([1.0, 0.0, 0.0]) - normals[:, :1] * normals
        of_second = np.array([0.0, 1.0, 0.0]) - normals[:, 1:2] * normals
        first_is_normal = np.linalg.norm(of_first, axis=1, keepdims=True) < 1e-9
        x_axes = np.where(first_is_normal, of_second, of_first)
        x_axes /= np.linalg.norm(x_axes, axis=1, keepdims=True)
        y_axes = np.cross(normals, x_axes)
        return np.stack([x_axes.T, y_axes.T]).astype(np.float32)

    def describe(self, scan: Scan) -> Float32Array:
        """Return the first left and right singular vectors, one after the other.

        Raises:
            InvalidScan: If all returns are at one place.
        """
        points = voxel_means(scan.points_m, self.voxel_m) if self.voxel_m else scan.points_m
        aligned = _principal(points.astype(np.float64))
        farthest_m = float(np.sqrt(np.square(aligned).sum(axis=1).max()))
        if not farthest_m > 0:
            raise InvalidScan(f"all {len(scan)} returns are at one place")
        signature = self._signature((aligned / farthest_m).astype(np.float32))
        left, _, right = np.linalg.svd(signature, full_matrices=False)
        first = [left[:, 0], right[0]]
        return np.concatenate([v if v.sum() >= 0 else -v for v in first]).astype(np.float32)

    def _signature(self, points: Float32Array) -> FloatArray:
        """Count returns of a unit ball on every plane, `(p q, l t)`."""
        x_axes, y_axes = self._axes
        planes, cells = x_axes.shape[1], self.circles * self.sectors
        offset = (cells * np.arange(planes)).astype(np.int32)
        counts = np.zeros(planes * cells, np.int64)
        for start in range(0, len(points), _BLOCK):
            block = points[start : start + _BLOCK]
            x, y = block @ x_axes, block @ y_axes
            # The k-th circle's radius is k^2 r: the square root of the radius is cut evenly.
            circle = (np.sqrt(np.sqrt(x * x + y * y)) * np.float32(self.circles)).astype(np.int32)
            np.minimum(circle, self.circles - 1, out=circle)
            turns = np.arctan2(y, x) * np.float32(0.5 / np.pi)
            sector = np.floor(turns * np.float32(self.sectors)).astype(np.int32) % self.sectors
            counts += np.bincount(
                (offset + circle * self.sectors + sector).ravel(), minlength=len(counts)
            )
        return counts.reshape(planes, cells).astype(np.float64)

    def places(self, descriptors: Float32Array) -> Places:
        """Return places to search."""
        return M2dpPlaces(descriptors)


def _principal(points: FloatArray) -> FloatArray:
    """Return points about their centroid, along their principal axes, the longest first."""
    centred = points - points.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    first, second = (
        axis if np.power(centred @ axis, 3).sum() >= 0 else -axis
        for axis in (vectors[:, 2], vectors[:, 1])
    )
    return np.asarray(centred @ np.stack([first, second, np.cross(first, second)], axis=1))


class M2dpPlaces(Places):
    """Places by the Euclidean distance of their descriptors, which have no heading."""

    def __init__(self, descriptors: Float32Array) -> None:
        super().__init__(descriptors)
        self._descriptors = descriptors.astype(np.float32)

    def _nearest(self, descriptor: Float32Array, last: int) -> Nearest:
        """Return the nearest place."""
        distances = np.linalg.norm(self._descriptors[:last] - descriptor, axis=1)
        row = int(distances.argmin())
        return Nearest(row, float(distances[row]))
