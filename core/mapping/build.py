"""From images to a TensorMap (paper, sec. 2.2), in two passes that hold a block at a time."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.grams import drive_gram, fit_radial_basis
from core.encodings.harmonic import HarmonicModel, encode, energy
from core.encodings.paper import PaperModel
from core.encodings.tucker import BLOCK_SCANS, Grams, leading_basis, project, relative_error
from core.errors import InvalidImage, InvalidParameters, SensorMismatch
from core.mapping.calibrate import calibrate
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.images import ImageSource, Probes
from core.scans.trajectory import Trajectory
from core.topology import join_segments

__all__ = ["fit_bases", "fit_map"]


def fit_map(
    images: ImageSource,
    trajectory: Trajectory,
    segment_start: IntArray,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
    probes: Probes | None = None,
    *,
    radial_basis: Float32Array | None = None,
    grams: Mapping[str, FloatArray] | None = None,
) -> TensorMap:
    """Fit each segment's model, pack them all and find out how far the map can be trusted.

    Each segment is summed in blocks that begin at its first scan, and segments in their order, so
    the result depends on nothing but the images and the cuts. In the paper's encoding segments are
    independent; in the harmonic one they share a basis.

    Args:
        images: One image a scan of the trajectory, on the parameters' grid.
        trajectory: Drive, time and pose of each scan.
        segment_start: `(L + 1,)` rows where segments begin, and K; those that
            `core.topology.cut_at_meetings` gives share edges where drives meet.
        parameters: Ranks and all that queries must share with the map.
        progress: Told of every image of each pass; may raise `Cancelled`.
        probes: Disturbed scans of the trajectory; without them the map is not calibrated.
        radial_basis: `(I, r1)` U to keep, of a harmonic map: signatures that were made with it
            stay good, and there is one pass only. It is fitted without.
        grams: What `drive_gram` gave for every drive, by name: U is fitted to these, and there is
            one pass only.

    Raises:
        SensorMismatch: If the images are on another grid.
        InvalidParameters: If the radial basis or the sums do not fit the parameters or drives.
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
    fit: Callable[..., tuple[PaperModel | HarmonicModel, FloatArray]] = _fit_paper
    if parameters.distance is not None:
        fit = partial(_fit_harmonic, trajectory, radial_basis, grams)
    elif radial_basis is not None or grams is not None:
        raise InvalidParameters("the paper's encoding has no radial basis: segments have their own")
    one_pass = radial_basis is not None or grams is not None
    progress.start("fitting", len(images) if one_pass else 2 * len(images))
    model, errors = fit(images, segment_start, parameters, progress)
    tensor_map = TensorMap(
        parameters, model, trajectory, join_segments(trajectory, segment_start), errors
    )
    if probes is None:
        return tensor_map
    return replace(tensor_map, calibration=calibrate(tensor_map, probes, progress))


def _fit_paper(
    images: ImageSource, segment_start: IntArray, parameters: MapParameters, progress: Progress
) -> tuple[PaperModel, FloatArray]:
    """Fit each segment's own bases, one segment after the other."""
    segments, (rows, columns), (r1, r2) = (
        len(segment_start) - 1,
        parameters.grid.shape,
        parameters.ranks,
    )
    elevation_basis = np.empty((segments, rows, r1), np.float32)
    azimuth_basis = np.empty((segments, columns, r2), np.float32)
    signatures = np.empty((len(images), r1, r2), np.float32)
    errors = np.empty(segments)
    for segment, (start, end) in enumerate(itertools.pairwise(segment_start.tolist())):
        squared_norm, u, v = fit_bases(images, start, end, parameters, progress)
        for block_start, block in _blocks(images, start, end, parameters, progress):
            signatures[block_start : block_start + len(block)] = project(block, u, v)
        elevation_basis[segment], azimuth_basis[segment] = u, v
        errors[segment] = relative_error(squared_norm, signatures[start:end])
    return PaperModel(elevation_basis, azimuth_basis, signatures, segment_start), errors


def _fit_harmonic(
    trajectory: Trajectory,
    radial_basis: Float32Array | None,
    grams: Mapping[str, FloatArray] | None,
    images: ImageSource,
    segment_start: IntArray,
    parameters: MapParameters,
    progress: Progress,
) -> tuple[HarmonicModel, FloatArray]:
    """Fit one radial basis to all renderings of all scans unless it is given, and encode them.

    A segment's relative error is sqrt(1 - sum |G|^2 / sum |S|^2) over its scans' renderings, |G|
    in the weighted norm: U and the harmonics are orthonormal, so that is what they leave out.
    """
    if parameters.distance is None or parameters.lateral_renderings_m is None:
        raise InvalidParameters("a harmonic map wants distance and lateral_renderings_m")
    (rows, columns), (r1, r2) = parameters.grid.shape, parameters.ranks
    if radial_basis is None:
        if grams is None:
            spans = itertools.pairwise(trajectory.drive_start.tolist())
            grams = {
                name: drive_gram(images, start, end, progress)
                for name, (start, end) in zip(trajectory.drives, spans, strict=True)
            }
        _require_grams(grams, trajectory, rows)
        radial_basis = fit_radial_basis(grams, r1)
    if radial_basis.shape != (rows, r1):
        raise InvalidParameters(f"radial_basis is {radial_basis.shape}, wanted {(rows, r1)}")
    signatures = np.empty((len(images), len(parameters.lateral_renderings_m), r1, r2), np.complex64)
    errors = np.zeros(len(segment_start) - 1)
    for segment, (start, end) in enumerate(itertools.pairwise(segment_start.tolist())):
        kept = whole = 0.0
        for block_start, block in _blocks(images, start, end, parameters, progress):
            encoded = encode(block, radial_basis, r2)
            signatures[block_start : block_start + len(block)] = encoded
            kept += float(energy(encoded, columns).sum())
            whole += float(np.square(block, dtype=np.float64).sum())
        if whole > 0.0:
            errors[segment] = np.sqrt(max(0.0, 1.0 - kept / whole))
    return HarmonicModel(
        radial_basis,
        signatures,
        np.array(parameters.lateral_renderings_m),
        segment_start,
        columns,
        parameters.distance,
    ), errors


def _require_grams(grams: Mapping[str, FloatArray], trajectory: Trajectory, rows: int) -> None:
    if set(grams) != set(trajectory.drives):
        raise InvalidParameters(
            f"the sums are of drives {sorted(grams)}, wanted {sorted(trajectory.drives)}"
        )
    for name, gram in grams.items():
        if gram.shape != (rows, rows):
            raise InvalidParameters(f"the sum of drive {name} is {gram.shape}, wanted {rows} rows")


def fit_bases(
    images: ImageSource,
    start: int,
    end: int,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
) -> tuple[float, FloatArray, FloatArray]:
    """Return |X|^2, U `(I, r1)` and V `(J, r2)` of the images `start` up to `end`."""
    grams = Grams.zero(images.grid.shape)
    for _, block in _blocks(images, start, end, parameters, progress):
        grams += Grams.of(block)
    r1, r2 = parameters.ranks
    u, v = leading_basis(grams.elevation, r1), leading_basis(grams.azimuth, r2)
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
    images: ImageSource, start: int, end: int, parameters: MapParameters, progress: Progress
) -> Iterator[tuple[int, Float32Array]]:
    for block_start in range(start, end, BLOCK_SCANS):
        block_end = min(block_start + BLOCK_SCANS, end)
        block = images.read(block_start, block_end)
        wanted = (block_end - block_start, *parameters.imager.shape)
        if block.shape != wanted:
            raise InvalidImage(f"the images read {block.shape}, wanted {wanted}")
        yield block_start, block
        progress.advance(len(block))
