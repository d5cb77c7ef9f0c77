"""Recorded drives, of the folder that TENSORMAP_DATA names."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from core.arrays import IntArray
from core.mapping.pipeline import DriveImages, build, project_scans
from core.mapping.tensormap import TensorMap
from core.parallel import blas_in_one_thread
from core.parameters import MapParameters
from core.projection.images import MemoryImages, ProjectedDrive, project_drive
from core.scans.drive import Drive
from storage.formats.drives.layouts import open_drive
from tests.support.locks import one_at_a_time


class Drives:
    """Recorded drives by name; one that is not there skips its test.

    Args:
        folder: The folder of drives.
        shared: A folder of all workers.
    """

    def __init__(self, folder: Path, shared: Path) -> None:
        self._folder = folder
        self._shared = shared
        self._opened = cache(lambda name: open_drive(self.path(name), min_returns=100))
        self._rendered_once = cache(self._rendered)

    def path(self, name: str) -> Path:
        path = self._folder / name
        if not path.is_dir():
            pytest.skip(f"TENSORMAP_DATA has no drive {name}")
        return path

    def open(self, name: str) -> Drive:
        return self._opened(name)

    def rendered(self, name: str, parameters: MapParameters) -> ProjectedDrive | None:
        """Return all scans of a drive as the default parameters render them, without probes.

        That is half of the time of a map. One worker of a run does it for all of them. `None` for
        parameters that render otherwise, as few tests do.
        """
        is_default = parameters.imager == MapParameters.for_sensor().imager
        return self._rendered_once(name) if is_default else None

    def built(self, name: str, scans: IntArray, parameters: MapParameters) -> TensorMap:
        """Return the map of some scans of a drive."""
        rendered = self.rendered(name, parameters)

        def images_of(drive: Drive) -> DriveImages:
            return project_scans(drive, scans, parameters, rendered=rendered)

        with blas_in_one_thread():
            return build([self.open(name)], parameters, images_of).tensor_map

    def _rendered(self, name: str) -> ProjectedDrive:
        imager, path = MapParameters.for_sensor().imager, self._shared / f"{name}.npy"
        drive = self.open(name)
        every = np.arange(len(drive))
        with one_at_a_time(path.with_suffix(".lock")):
            if not path.exists():
                made = path.with_suffix(".part.npy")
                projected = project_drive(drive, every, imager, most_probes=0)
                assert not projected.skipped
                np.save(made, projected.read(0, len(drive)))
                made.rename(path)
        images = MemoryImages(np.load(path, mmap_mode="r"), imager.grid)
        no_probes = MemoryImages(np.empty((0, *imager.grid.shape), np.float32), imager.grid)
        returns, probed, displacement = 0, np.empty(0, np.int64), np.empty((0, 3))  # nobody reads
        return ProjectedDrive(every, returns, (), probed, displacement, images, no_probes)
