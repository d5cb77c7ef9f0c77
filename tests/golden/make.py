"""How the golden files were made: `python -m tests.golden.make FOLDER` in the release's worktree.

A released file is never made again: a new release adds its own.
"""

import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from core.encodings.distance import Distance
from core.mapping.fit import fit_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Views
from core.projection.images import MemoryImages
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.sensor import AngularGrid
from core.scans.trajectory import Trajectory
from storage.files.map_file import write_map


def golden_map() -> TensorMap:
    """Return a map of two drives of three scans each, one of them without poses."""
    grid = AngularGrid(
        elevation_min_deg=-15.0, elevation_step_deg=10.0, rows=4, azimuth_step_deg=45.0
    )
    ranges_m = np.random.default_rng(1).uniform(1.0, 80.0, size=(6, *grid.shape))
    poses = np.zeros((3, 7))
    poses[:, 0], poses[:, 6] = np.arange(3), 1.0
    return fit_map(
        MemoryImages(ranges_m.astype(np.float32), grid),
        Trajectory.concatenate(
            [
                Trajectory.of_drive("monday", np.arange(3) / 10.0, poses, np.array([0, 1, 3])),
                Trajectory.of_drive(
                    "tuesday", np.full(3, np.nan), np.full((3, 7), np.nan), np.arange(3)
                ),
            ]
        ),
        np.array([0, 2, 3, 6]),
        MapParameters(ranks=(2, 3), reducer=Reducer.MEAN, sensor="vlp-16", grid=grid),
    )


def golden_harmonic_map() -> TensorMap:
    """Return the same drives in the harmonic encoding, two renderings each."""
    paper = golden_map()
    parameters = MapParameters(
        encoding="harmonic",
        ranks=(2, 3),
        reducer=Reducer.HIGHEST,
        sensor="vlp-16",
        grid=RingGrid(ring_m=10.0, rings=4, azimuth_step_deg=45.0),
        distance=Distance.NORMALISED,
        lateral_renderings_m=(-1.5, 0.0),
    )
    heights_m = np.random.default_rng(2).uniform(0.0, 5.0, size=(6, *parameters.imager.shape))
    return fit_map(
        MemoryImages(heights_m.astype(np.float32), parameters.grid),
        paper.trajectory,
        paper.model.segment_start,
        parameters,
    )


def golden_map_of_any_views(*, verification_images: bool = False) -> TensorMap:
    """Return the same drives in a map of any views; a column of every third scan is hidden."""
    paper = golden_map()
    parameters = replace(
        golden_harmonic_map().parameters,
        grid=RingGrid(ring_m=10.0, rings=4, azimuth_step_deg=6.0),
        views=Views.ANY,
        verification_images=verification_images,
    )
    heights_m = np.random.default_rng(4).uniform(0.0, 5.0, size=(6, *parameters.imager.shape))
    heights_m[::3, :, :, 7] = -1.0
    return fit_map(
        MemoryImages(heights_m.astype(np.float32), parameters.grid),
        paper.trajectory,
        paper.model.segment_start,
        parameters,
    )


def make(folder: Path) -> None:
    """Write this release's golden files."""
    write_map(folder / "map-v1.h5", golden_map(), datetime(2026, 1, 1, tzinfo=UTC))
    now = datetime(2026, 11, 23, tzinfo=UTC)
    write_map(folder / "harmonic-v3.h5", golden_harmonic_map(), now)
    verified = golden_map_of_any_views(verification_images=True)
    write_map(folder / "harmonic-v3-images.h5", verified, now)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
