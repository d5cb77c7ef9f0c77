"""Small scans, drives and maps of seeded random content."""

from dataclasses import replace
from typing import Any

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.distance import Distance
from core.encodings.signature import Signature
from core.errors import InvalidScan
from core.mapping.fit import fit_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Image
from core.projection.images import MemoryImages, Probes
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.tracking.track import Observation, Tracker

SMALL_GRID = AngularGrid(
    elevation_min_deg=-30.0, elevation_step_deg=10.0, rows=6, azimuth_step_deg=20.0
)
"""6 x 19 cells."""


def random_images(count: int, shape: tuple[int, int], seed: int = 0) -> Float32Array:
    """Return `(count, I, J)` images with some empty cells, no two alike."""
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(1.0, 50.0, size=(count, *shape))
    ranges[rng.random(ranges.shape) < 0.2] = 0.0
    ranges[:, 0, 0] = 7.0
    return ranges.astype(np.float32)


def straight_poses(count: int, step_m: float = 1.0) -> FloatArray:
    """Return `(count, 7)` pose rows along x."""
    rows = np.zeros((count, 7))
    rows[:, 0], rows[:, 6] = step_m * np.arange(count), 1.0
    return rows


def trajectory(*drives: FloatArray) -> Trajectory:
    """Return the trajectory of drives by their `(K, 7)` poses, ten scans a second."""
    return Trajectory.concatenate(
        [
            Trajectory.of_drive(f"d{i}", np.arange(len(p)) / 10.0, p, np.arange(len(p)))
            for i, p in enumerate(drives)
        ]
    )


def two_drives(**changes: Any) -> Trajectory:
    """Return the trajectory of drives of two and three scans along x, with changed parts."""
    parts: dict[str, Any] = {
        "drives": ("a", "b"),
        "drive_start": [0, 2, 5],
        "scan_index": [3, 7, 0, 1, 2],
        "timestamp_s": np.arange(5.0),
        "poses": straight_poses(5),
    }
    return Trajectory(**{**parts, **changes})


def sample_points(seed: int, returns: int = 60) -> Float32Array:
    """Return `(returns, 3)` metres around the sensor, within 30 degrees of its horizon."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(-np.pi, np.pi, returns)
    elevation = rng.uniform(-0.5, 0.4, returns)
    range_m = rng.uniform(2.0, 60.0, returns)
    across = range_m * np.cos(elevation)
    return np.stack(
        [across * np.cos(azimuth), across * np.sin(azimuth), range_m * np.sin(elevation)],
        axis=1,
        dtype=np.float32,
        casting="same_kind",
    )


def sample_drive(
    count: int, seed: int = 0, *, poses: bool = True, name: str = "drive", returns: int = 60
):
    """Return a drive of `count` unlike scans, a metre and a tenth of a second apart."""
    rows = straight_poses(count)
    return MemoryDrive(
        name,
        [
            Scan.from_returns(
                sample_points(1000 * seed + i, returns),
                timestamp_s=0.1 * i,
                pose=Pose.from_row(rows[i]) if poses else None,
            )
            for i in range(count)
        ],
    )


class FaultyDrive:
    """A drive some of whose scans cannot be used."""

    def __init__(self, drive: MemoryDrive, faulty: set[int]) -> None:
        self.name, self.timestamp_s, self.poses = drive.name, drive.timestamp_s, drive.poses
        self._drive, self._faulty = drive, faulty

    def __len__(self) -> int:
        return len(self._drive)

    def scan(self, index: int) -> Scan:
        if index in self._faulty:
            raise InvalidScan(f"scan {index} is torn")
        return self._drive.scan(index)


def sample_map(
    count: int = 24,
    segment_length: int = 8,
    *,
    drives: int = 1,
    poses: bool = True,
    seed: int = 0,
    step_m: float = 1.0,
) -> tuple[TensorMap, Float32Array]:
    """Return a map of `drives` drives of `count` random images each, and all images."""
    parameters = MapParameters(grid=SMALL_GRID, ranks=(3, 4), sensor="hdl-64e")
    images = random_images(count * drives, SMALL_GRID.shape, seed)
    trajectory = Trajectory.concatenate(
        [
            Trajectory.of_drive(
                f"drive-{d}",
                0.1 * np.arange(count, dtype=np.float64),
                straight_poses(count, step_m) + np.array([0, 1000.0 * d, 0, 0, 0, 0, 0])
                if poses
                else np.full((count, 7), np.nan),
                np.arange(count),
            )
            for d in range(drives)
        ]
    )
    cuts: IntArray = cut_drives(trajectory.drive_start, segment_length)
    return fit_map(MemoryImages(images, SMALL_GRID), trajectory, cuts, parameters), images


def sample_harmonic_map(
    count: int = 24, segment_length: int = 8, *, drives: int = 1, poses: bool = True, seed: int = 0
) -> tuple[TensorMap, Float32Array]:
    """Return a harmonic map of random height images, and its renderings `(K, 3, 6, 18)`."""
    grid = RingGrid(ring_m=10.0, rings=6, azimuth_step_deg=20.0)
    parameters = MapParameters(
        "harmonic", (3, 4), Reducer.MEAN, "hdl-64e", grid, 1.73, Distance.NORMALISED,
        (-2.0, 0.0, 2.0),
    )  # fmt: skip
    images = random_images(3 * count * drives, grid.shape, seed).reshape(-1, 3, *grid.shape)
    paper, _ = sample_map(count, segment_length, drives=drives, poses=poses, seed=seed)
    return fit_map(
        MemoryImages(images, grid), paper.trajectory, paper.model.segment_start, parameters
    ), images


def without_poses(tensor_map: TensorMap, *rows: int) -> TensorMap:
    """Return the map without the poses of some scans."""
    poses = tensor_map.trajectory.poses.copy()
    poses[list(rows)] = np.nan
    return replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))


def own_signatures(tensor_map: TensorMap, row: int) -> tuple[Signature, ...]:
    """Return the signatures of a query at scan `row` of the map."""
    return next(tensor_map.model.own_queries([row], tensor_map.revision))


def observed(tracker: Tracker, row: int, **given: Any) -> Observation:
    """Return an observation at scan `row` of a tracker's map, with its number, time or odometry."""
    return Observation(own_signatures(tracker.map, row), **given)


def sample_image(tensor_map: TensorMap, cells: Float32Array) -> Image:
    """Return an image on the map's grid."""
    return Image(cells, tensor_map.parameters.grid)


class RecordedProgress:
    """Records stages and units."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, int]] = []
        self.done: list[int] = []

    def start(self, stage: str, total: int) -> None:
        self.stages.append((stage, total))
        self.done.append(0)

    def advance(self, units: int = 1) -> None:
        self.done[-1] += units


def smooth_images(count: int, shape: tuple[int, int], seed: int = 0) -> Float32Array:
    """Return `(count, I, J)` images that change from one random image to the next in 8 steps."""
    keys = random_images(count // 8 + 2, shape, seed).astype(np.float64)
    at = np.arange(count) / 8
    low = at.astype(np.int64)
    share = (at - low)[:, None, None]
    return ((1.0 - share) * keys[low] + share * keys[low + 1]).astype(np.float32)


def calibrated_map(count: int = 120, *, poses: bool = True, seed: int = 0) -> TensorMap:
    """Return a paper map of smooth images a metre apart, calibrated on noisy ones."""
    images = smooth_images(count, SMALL_GRID.shape, seed)
    trajectory = Trajectory.of_drive(
        "smooth",
        0.1 * np.arange(count, dtype=np.float64),
        straight_poses(count) if poses else np.full((count, 7), np.nan),
        np.arange(count),
    )
    parameters = MapParameters(grid=SMALL_GRID, ranks=(3, 4), sensor="hdl-64e")
    return fit_map(
        MemoryImages(images, SMALL_GRID),
        trajectory,
        np.array([0, count // 2, count]),
        parameters,
        probes=noisy_probes(images, seed),
    )


def noisy_probes(images: Float32Array, seed: int = 0) -> Probes:
    """Return a probe of every second image, with noise."""
    rows = np.arange(0, len(images), 2)
    noise = np.random.default_rng(seed).normal(scale=0.5, size=images[rows].shape)
    noisy = np.maximum(images[rows] + noise, 0.1).astype(np.float32)
    return Probes(rows, np.zeros((len(rows), 3)), MemoryImages(noisy, SMALL_GRID))
