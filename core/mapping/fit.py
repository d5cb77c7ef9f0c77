"""From images to a TensorMap (paper, sec. 2.2), in two passes, one block in memory at a time."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from core.arrays import FloatArray, IntArray
from core.encodings.basis import Basis
from core.errors import InvalidParameters, SensorMismatch
from core.mapping.calibrate import calibrate
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.images import ImageSource, Probes
from core.scans.trajectory import Trajectory
from core.topology import join_segments


def fit_map(
    images: ImageSource,
    trajectory: Trajectory,
    segment_start: IntArray,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
    probes: Probes | None = None,
    *,
    kept: Basis | None = None,
    grams: Mapping[str, FloatArray] | None = None,
) -> TensorMap:
    """Fit each segment's model, join them and calibrate the map.

    Each segment is summed in blocks that begin at its first scan, and segments in their order, so
    the result depends only on the images and the cuts.

    Args:
        images: One image a scan of the trajectory, on the parameters' grid.
        trajectory: Drive, time and pose of each scan.
        segment_start: `(L + 1,)` rows where segments begin, and K; those that
            `core.topology.cut_at_meetings` returns share edges where drives meet.
        parameters: Ranks and all that queries must share with the map.
        progress: Receives every image of each pass; may raise `Cancelled`.
        probes: Disturbed scans of the trajectory; without them the map is not calibrated.
        kept: The basis of another map to keep instead of fitting one: its signatures stay valid.
        grams: The result of `drive_gram` for every drive, by name, if known.

    Raises:
        SensorMismatch: If the images are on another grid.
        InvalidParameters: If the basis or the sums do not fit the parameters or drives, the cuts do
            not cover the images, or a segment has scans of two drives.
        InvalidImage: If the source returns images of another number or shape.
    """
    if images.grid != parameters.grid:
        raise SensorMismatch(f"the images are on {images.grid}, wanted {parameters.grid}")
    if len(images) != len(trajectory):
        raise InvalidParameters(
            f"{len(images)} images and {len(trajectory)} scans do not fit together"
        )
    _require_cuts(trajectory, segment_start)
    if kept is not None and not kept.serves(parameters):
        raise InvalidParameters(
            f"the basis of {kept.parameters.as_attributes()} cannot be kept: its signatures differ,"
            " or segments have bases of their own"
        )
    model, errors = parameters.encoder.fit(
        images, trajectory, segment_start, parameters, progress, kept, grams
    )
    tensor_map = TensorMap(
        parameters, model, trajectory, join_segments(trajectory, segment_start), errors
    )
    if probes is None:
        return tensor_map
    calibration = calibrate(tensor_map, probes, progress)
    tensor_map = replace(tensor_map, calibration=calibration)
    if not parameters.verification_images:
        return tensor_map
    of_images = calibrate(tensor_map, probes, progress, by_images=True)
    return replace(tensor_map, image_calibration=of_images)


def _require_cuts(trajectory: Trajectory, segment_start: IntArray) -> None:
    ends = segment_start[:1].tolist() + segment_start[-1:].tolist()
    if ends != [0, len(trajectory)] or (np.diff(segment_start) < 1).any():
        raise InvalidParameters(
            f"the cuts {segment_start.tolist()} do not rise from 0 to {len(trajectory)}"
        )
    whole = np.isin(trajectory.drive_start, segment_start)
    if not whole.all():
        raise InvalidParameters(f"a segment runs into drive {np.argmin(whole)}: cut drives apart")
