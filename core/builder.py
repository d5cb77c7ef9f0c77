"""From images to a TensorMap (paper, sec. 2.2), in two passes that hold a block at a time."""

from collections.abc import Iterator

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.paper import PaperModel
from core.errors import InvalidImage, InvalidParameters, SensorMismatch
from core.images import ImageSource
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.tensormap import TensorMap
from core.topology import Topology
from core.trajectory import Trajectory
from core.tucker import BLOCK_SCANS, Grams, leading_basis, project, relative_error

__all__ = ["build_map", "fit_bases"]


def build_map(
    images: ImageSource,
    trajectory: Trajectory,
    segment_start: IntArray,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
) -> TensorMap:
    """Fit each segment's model and pack them all.

    Segments are independent and each is summed in blocks that begin at its first scan, so the
    result depends on nothing but the images and the cuts.

    Args:
        images: One image a scan of the trajectory, on the parameters' grid.
        trajectory: Drive, time and pose of each scan.
        segment_start: `(L + 1,)` rows where segments begin, and K.
        parameters: Ranks and all that queries must share with the map.
        progress: Told of every image of both passes; may raise `Cancelled`.

    Raises:
        SensorMismatch: If the images are on another grid.
        InvalidParameters: If the cuts do not cover the images, or a segment holds two drives.
        InvalidImage: If the source reads other images than it was asked for.
    """
    if images.grid != parameters.grid:
        raise SensorMismatch(f"the images are on {images.grid}, wanted {parameters.grid}")
    if len(images) != len(trajectory):
        raise InvalidParameters(
            f"{len(images)} images and {len(trajectory)} scans do not fit together"
        )
    _require_cuts(trajectory, segment_start)
    segments, (rows, columns), (r1, r2) = (
        len(segment_start) - 1,
        parameters.grid.shape,
        parameters.ranks,
    )
    elevation_basis = np.empty((segments, rows, r1), np.float32)
    azimuth_basis = np.empty((segments, columns, r2), np.float32)
    signatures = np.empty((len(images), r1, r2), np.float32)
    errors = np.empty(segments)
    progress.start("fitting", 2 * len(images))
    for segment, (start, end) in enumerate(
        zip(segment_start[:-1].tolist(), segment_start[1:].tolist(), strict=True)
    ):
        squared_norm, u, v = fit_bases(images, start, end, parameters.ranks, progress)
        for block_start, block in _blocks(images, start, end, progress):
            signatures[block_start : block_start + len(block)] = project(block, u, v)
        elevation_basis[segment], azimuth_basis[segment] = u, v
        errors[segment] = relative_error(squared_norm, signatures[start:end])
    return TensorMap(
        parameters,
        PaperModel(elevation_basis, azimuth_basis, signatures, segment_start),
        trajectory,
        Topology.of_segments(trajectory, segment_start),
        errors,
    )


def fit_bases(
    images: ImageSource,
    start: int,
    end: int,
    ranks: tuple[int, int],
    progress: Progress = NO_PROGRESS,
) -> tuple[float, FloatArray, FloatArray]:
    """Return |X|^2, U `(I, r1)` and V `(J, r2)` of the images `start` up to `end`."""
    grams = Grams.zero(images.grid.shape)
    for _, block in _blocks(images, start, end, progress):
        grams += Grams.of(block)
    u, v = leading_basis(grams.elevation, ranks[0]), leading_basis(grams.azimuth, ranks[1])
    return grams.squared_norm, u, v


def _require_cuts(trajectory: Trajectory, segment_start: IntArray) -> None:
    ends = segment_start[:1].tolist() + segment_start[-1:].tolist()
    if ends != [0, len(trajectory)] or (np.diff(segment_start) < 1).any():
        raise InvalidParameters(
            f"the cuts {segment_start.tolist()} do not rise from 0 to {len(trajectory)}"
        )
    whole = np.isin(trajectory.drive_start, segment_start)
    if not whole.all():
        raise InvalidParameters(f"a segment runs into drive {np.argmin(whole)}: cut drives apart")


def _blocks(
    images: ImageSource, start: int, end: int, progress: Progress
) -> Iterator[tuple[int, Float32Array]]:
    for block_start in range(start, end, BLOCK_SCANS):
        block_end = min(block_start + BLOCK_SCANS, end)
        block = images.read(block_start, block_end)
        wanted = (block_end - block_start, *images.grid.shape)
        if block.shape != wanted:
            raise InvalidImage(f"the images read {block.shape}, wanted {wanted}")
        yield block_start, block
        progress.advance(len(block))
