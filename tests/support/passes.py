"""Passes of the streets of a simulated city, and maps of them with other poses."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from core.arrays import FloatArray
from core.mapping.fit import fit_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.images import ConcatenatedImages, project_drive
from core.scans.drive import MemoryDrive
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.topology import cut_at_meetings

SCANS = 60

Change = Callable[[FloatArray], FloatArray]


@functools.lru_cache(2)
def passes(parameters: MapParameters) -> dict[str, Any]:
    """Return four drives and their images, by name.

    On another day, in another lane and the other way, and in another city.
    """
    drives = {
        "monday": _passed(),
        "tuesday": _passed(noise_seed=2),
        "back": _passed(noise_seed=3, reverse=True, lateral_offset_m=-3.0),
        "elsewhere": _passed(seed=5),
    }
    every, imager = np.arange(SCANS), parameters.imager
    return {
        name: (drive, project_drive(drive, every, imager, most_probes=0).images)
        for name, drive in drives.items()
    }


@functools.cache
def _passed(*, seed: int = 1, **other: Any) -> MemoryDrive:
    sensor = SimulatedSensor(firings=180)
    drive = SimulatedDrive(seed=seed, scans=SCANS, stops=False, sensor=sensor, **other)
    return MemoryDrive(drive.name, list(drive))


def map_of(parameters: MapParameters, **places: Change) -> TensorMap:
    """Return a map of some passes, the poses of each changed."""
    of = passes(parameters)
    trajectory = Trajectory.concatenate(
        [
            Trajectory.of_drive(
                name, of[name][0].timestamp_s, change(of[name][0].poses), np.arange(SCANS)
            )
            for name, change in places.items()
        ]
    )
    return fit_map(
        ConcatenatedImages([of[name][1] for name in places]),
        trajectory,
        cut_at_meetings(trajectory, cut_drives(trajectory.drive_start, 30)),
        parameters,
    )


def unchanged(poses: FloatArray) -> FloatArray:
    return poses


def unknown(poses: FloatArray) -> FloatArray:
    return np.full_like(poses, np.nan)


def moved(x_m: float = 0.0, rotation: Rotation | None = None) -> Change:
    """Return a function that transforms poses to another frame."""
    turn = Rotation.identity() if rotation is None else rotation

    def change(poses: FloatArray) -> FloatArray:
        rows = poses.copy()
        rows[:, :3] = turn.apply(rows[:, :3]) + np.array([x_m, 0.0, 0.0])
        rows[:, 3:] = (turn * Rotation.from_quat(rows[:, 3:])).as_quat()
        return rows

    return change
