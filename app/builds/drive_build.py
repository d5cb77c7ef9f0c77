"""Builds of drives, stored or not: the maps of a command are those of the service."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

import numpy as np

from app.builds.axis_notes import axis_notes
from app.builds.calibration_notes import calibration_notes
from app.builds.frame_checks import of_same_poses, pose_digests, require_frames
from app.builds.parameters import Align, BuildParameters
from app.builds.spacing_notes import spacing_notes
from core.encodings.basis import Basis
from core.frames.alignment import align_drives
from core.mapping.pipeline import Build, DriveImages, build
from core.mapping.placement import Placement, composed
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.path import path_length_m
from core.scans.pose import is_known
from core.scans.trajectory import Trajectory
from core.segmentation.fitting import fitting_length, require_segments
from storage.errors import StorageFailure, StorageFull
from storage.files.image_file import ImageFile, write_image_file


@dataclass(frozen=True, eq=False)
class Built(Build):
    """A map and what is known of its drives.

    Attributes:
        confirmed_frames: Digests of the poses of its drives, if all were found in one world frame.
        of_frames: Notes on the world frames of the drives.
        of_axes: Notes on drives whose scans do not have z up.
    """

    confirmed_frames: Mapping[str, str] = field(default_factory=dict)
    of_frames: tuple[str, ...] = ()
    of_axes: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the client that requested the build."""
        return (
            *calibration_notes(self.tensor_map),
            *(f"{fit}: consider to fit it anew" for fit in self.fits if fit.much_worse),
            *self.of_axes,
            *self.of_frames,
            *spacing_notes(self.tensor_map.trajectory),
        )


def build_drives(
    drives: Sequence[Drive],
    parameters: BuildParameters,
    progress: Progress = NO_PROGRESS,
    *,
    kept: Basis | None = None,
    frameless: Collection[str] = (),
) -> Built:
    """Build a map of drives of any length: their images are kept in temporary files.

    Args:
        drives: No two of one name.
        parameters: The parameters of the map and its segments; those of stored drives and revisions
            are not used.
        progress: Advanced with every scan.
        kept: The basis of another map, to keep.
        frameless: Names of drives whose poses are odometry, in a frame of their own.

    Raises:
        EmptyDrive: If a drive has no usable scan.
        InvalidParameters: If a parameter does not fit.
        InvalidMap: If two drives have one name.
        FramesDisagree: If the poses of two drives are in different world frames.
    """
    imager = parameters.map_parameters().imager
    require_segments(
        max(map(len, drives), default=0),
        segment_length=parameters.segment_length,
        segments=parameters.segments,
    )
    if parameters.segment_length is None and parameters.segments is None:
        parameters = with_fitting_segments(parameters, drives)

    @contextmanager
    def temporary_images(drive: Drive) -> Iterator[ImageFile]:
        with TemporaryDirectory(prefix="tensormap-") as folder:
            path = Path(folder) / "images.h5"
            with _named_errors(drive, path):
                write_image_file(path, drive, imager, progress)
            with ImageFile(path, imager) as images:
                yield images

    return build_mapped(drives, temporary_images, parameters, progress, kept, frameless=frameless)


@contextmanager
def _named_errors(drive: Drive, images: Path) -> Iterator[None]:
    """Raise the error of a scan that cannot be read as it is, and name the folder that is full.

    Scans are read while their images are written: both would be errors of a data directory.
    """
    try:
        yield
    except StorageFull as error:
        raise StorageFull(
            f"no space is left in {gettempdir()} for the images of {drive.name}: free some, or set"
            " TMPDIR to another folder"
        ) from error
    except StorageFailure as error:
        cause = error.__cause__
        if not isinstance(cause, OSError) or cause.filename is None:
            raise
        if Path(cause.filename).parent == images.parent:
            raise
        raise cause from None


def with_fitting_segments(parameters: BuildParameters, drives: Sequence[Drive]) -> BuildParameters:
    """Return parameters with segments that fit the longest drive."""
    longest = max(drives, key=len)
    rows, path_m = np.flatnonzero(is_known(longest.poses)), math.nan
    if len(rows) > 1:  # before the first pose and behind the last one as fast as in between
        of_all = (len(longest) - 1) / float(rows[-1] - rows[0])
        path_m = of_all * path_length_m(longest.poses[rows])
    length = fitting_length(len(longest), path_m)
    return parameters.model_copy(update={"segment_length": length})


def _in_frame(
    trajectory: Trajectory, confirmed: Mapping[str, str], frameless: Collection[str]
) -> set[str]:
    """Return the drives that are in the frame of the map as they are.

    Drives whose poses have no frame are not, once there is one that has: its frame is the map's.
    """
    same = of_same_poses(trajectory, confirmed)
    with_frame = {*pose_digests(trajectory)} - {*frameless}
    return same if not with_frame or same & with_frame else set()


def build_mapped(
    drives: Sequence[Drive],
    images_of: Callable[[Drive], AbstractContextManager[ImageFile]],
    parameters: BuildParameters,
    progress: Progress,
    kept: Basis | None,
    *,
    placements: Mapping[str, Placement] | None = None,
    frameless: Collection[str] = (),
    confirmed: Mapping[str, str] | None = None,
) -> Built:
    """Build the map of drives, their poses as placed before, and check or align their frames.

    Args:
        drives: No two of one name.
        images_of: Opens the images of a drive.
        parameters: The parameters of the map and its segments.
        progress: Advanced with every scan.
        kept: The basis of another map, to keep.
        placements: The transforms of poses, by drive.
        frameless: Names of drives whose poses are odometry, in a frame of their own.
        confirmed: The `confirmed_frames` of an earlier map: if these drives have the same poses,
            they are not matched again.
    """
    confirmed = confirmed or {}
    with ExitStack() as stack:
        images: dict[str, DriveImages] = {}  # a build that aligns reads them twice

        def opened(drive: Drive) -> DriveImages:
            if drive.name not in images:
                images[drive.name] = stack.enter_context(images_of(drive))
            return images[drive.name]

        def made(placements: Mapping[str, Placement], *, calibrated: bool = True) -> Build:
            return build(
                drives,
                parameters.map_parameters(),
                opened,
                segment_length=parameters.segment_length,
                segments=parameters.segments,
                kept=kept,
                calibrated=calibrated,
                placements=placements,
                progress=progress,
            )

        before, notes = dict(placements or {}), tuple[str, ...]()
        names = [drive.name for drive in drives]
        movable = names if parameters.align == Align.AUTO else frameless
        unsure: set[str] = set()
        if movable and len(drives) > 1:
            rough = made(before, calibrated=False).tensor_map
            in_frame = _in_frame(rough.trajectory, confirmed, frameless)
            others = [name for name in movable if name not in in_frame]
            aligned = align_drives(rough, others, frameless, progress)
            before, notes = composed(before, aligned.placements), aligned.notes
            unsure |= {*aligned.apart}
        result = made(before)
        tensor_map = replace(result.tensor_map, computed_poses=tuple(frameless))
        result = replace(result, tensor_map=tensor_map)
        if parameters.align == Align.CHECK:
            checked = require_frames(tensor_map, frameless, confirmed, progress)
            notes += checked.notes
            unsure |= {*checked.unsure}
        elif parameters.align == Align.OFF:
            unsure |= {*names}
    of_axes = axis_notes(drives, parameters.map_parameters().sensor_height_m, frameless)
    return Built(
        **vars(result),
        confirmed_frames={} if unsure else pose_digests(tensor_map.trajectory),
        of_frames=notes,
        of_axes=tuple(of_axes),
    )
