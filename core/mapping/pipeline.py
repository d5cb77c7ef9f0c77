"""From drives to a TensorMap: project, cut, join, fit, calibrate (paper, sec. 2).

This is the only place where maps are put together. The service, the commands, the evaluation and
the comparison call it; the service adds where images are kept between builds.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.encodings.basis import Basis, BasisFit
from core.encodings.compression import Compression
from core.encodings.grams import drive_gram
from core.errors import InvalidParameters
from core.mapping.fit import fit_map
from core.mapping.placement import Placement, placed
from core.mapping.tensormap import TensorMap
from core.parallel import blas_in_one_thread
from core.parameters import MapParameters, Segmentation
from core.progress import NO_PROGRESS, Progress
from core.projection.images import (
    ConcatenatedImages,
    ImageSource,
    MemoryBuffer,
    NewBuffer,
    Probes,
    ProjectedDrive,
    Skipped,
    project_drive,
)
from core.projection.probe import PROBES
from core.scans.drive import Drive, scan_index_of
from core.scans.stands import first_of_stands
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives, cut_fixed, segment_length_for
from core.segmentation.turns import cut_at_turns
from core.segmentation.unequal import cut_unequal
from core.topology import cut_at_meetings


class DriveImages(ImageSource, Protocol):
    """The images of a drive's usable scans, in memory or in a file."""

    @property
    def scans(self) -> IntArray:
        """`(n,)` positions of the usable scans in the drive, rising."""

    @property
    def returns(self) -> int:
        """How many returns they have together."""

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """The scans that could not be used."""

    @property
    def probed(self) -> IntArray:
        """`(p,)` positions of the scans that have a probe, rising."""

    @property
    def displacement(self) -> FloatArray:
        """`(p, 3)` displacements of the probes, as in `Probes`."""

    @property
    def probes(self) -> ImageSource | None:
        """The images of the probes; `None` if they are not available."""

    def detail_gram(self, counted: BoolArray) -> FloatArray:
        """Return `core.encodings.grams.drive_gram` of these images, `(I, I)`.

        Args:
            counted: `(n,)` which of them count.
        """


ImagesOf = Callable[[Drive], DriveImages]
"""Where the images of a drive come from."""


@dataclass(frozen=True, eq=False)
class _WithDetailGram(ProjectedDrive):
    def detail_gram(self, counted: BoolArray) -> FloatArray:
        return drive_gram(self.images, 0, counted)


@dataclass(frozen=True, eq=False)
class Build:
    """A map and what is known of its drives.

    Attributes:
        tensor_map: The map.
        returns: How many returns its scans had together.
        skipped: Scans that could not be used, by drive, with their numbers.
        fits: How well a basis that was kept fits each drive; none if it was fitted.
        segment_length: k that drives were cut with, `None` if the cuts were given.
    """

    tensor_map: TensorMap
    returns: int
    skipped: Mapping[str, tuple[Skipped, ...]]
    fits: tuple[BasisFit, ...] = ()
    segment_length: int | None = None

    @property
    def compression(self) -> Compression:
        """The map's numbers against those of its images and returns."""
        return Compression.of(
            self.tensor_map.elements,
            scans=len(self.tensor_map),
            grid_shape=self.tensor_map.parameters.grid.shape,
            returns=self.returns,
            verification_bytes=self.tensor_map.verification_bytes,
        )


def build_map(
    drives: Drive | Sequence[Drive],
    parameters: MapParameters,
    *,
    segment_length: int | None = None,
    segments: int | None = None,
    kept: Basis | None = None,
    progress: Progress = NO_PROGRESS,
) -> TensorMap:
    """Build the map of one or more drives.

    Equal drives and parameters have equal digests, with the same packages and kind of processor.
    The last digits of a calibration depend on the number of BLAS threads, so that there is one
    until the map is built, in all of this process, as in the service and the commands. Images are
    in memory, 43 kB a scan (and rendering) on the paper's grid.

    Args:
        drives: One, or several of different names in one world frame.
        parameters: The map's: `MapParameters()` are the paper's, `MapParameters.for_sensor()`
            those of `tensormap build`.
        segment_length: k; 760 scans by default.
        segments: L instead: k = ceil(K / L) of the longest drive's K usable scans.
        kept: The basis of another map to keep; its signatures stay valid.
        progress: Receives every stage; may raise `Cancelled`.

    Raises:
        EmptyDrive: If there is no drive, or one has no usable scan.
        InvalidParameters: If a parameter does not fit.
        InvalidMap: If two drives have one name.
    """
    with blas_in_one_thread():
        return build(
            [drives] if not isinstance(drives, Sequence) else drives,
            parameters,
            segment_length=segment_length,
            segments=segments,
            kept=kept,
            progress=progress,
        ).tensor_map


def build(
    drives: Sequence[Drive],
    parameters: MapParameters,
    images_of: ImagesOf | None = None,
    *,
    segment_length: int | None = None,
    segments: int | None = None,
    segment_start: IntArray | None = None,
    kept: Basis | None = None,
    calibrated: bool = True,
    placements: Mapping[str, Placement] | None = None,
    progress: Progress = NO_PROGRESS,
) -> Build:
    """Build the map of drives, and return what is known of them besides.

    No segment may be empty. Segments that are cut here are cut over usable scans and never are; of
    cuts that were made before some scans were held out, one that leaves a segment without a scan
    is rejected: a map whose segments were merged would number them otherwise than its queries.

    Args:
        drives: No two of one name.
        parameters: The map's.
        images_of: Returns a drive's images; all its scans are projected into memory by default.
        segment_length: k, in usable scans.
        segments: L instead: k = ceil(K / L) of the longest drive's K usable scans.
        segment_start: `(L + 1,)` positions in the only drive where segments begin, and its length:
            instead of cuts over usable scans, at turns and where drives meet.
        kept: The basis of another map to keep; its signatures stay valid.
        calibrated: Whether the map is calibrated with its probes.
        placements: Transforms of the poses of some drives, by name; none by default.
        progress: Receives every stage; may raise `Cancelled`.

    Raises:
        EmptyDrive: If there is no drive, or one has no usable scan.
        InvalidParameters: If a parameter does not fit, or a segment is left without a scan.
        InvalidMap: If two drives have one name.
    """
    if images_of is None:

        def images_of(drive: Drive) -> DriveImages:
            every, probes = np.arange(len(drive)), PROBES if calibrated else 0
            return project_scans(drive, every, parameters, progress, most_probes=probes)

    images = [images_of(drive) for drive in drives]
    given = Trajectory.concatenate(
        [
            trajectory_of(drive, projected.scans)
            for drive, projected in zip(drives, images, strict=True)
        ]
    )
    placements = placements or {}
    trajectory = placed(
        given, {name: placement.transform for name, placement in placements.items()}
    )
    joined = ConcatenatedImages(images)
    length: int | None = None
    if segment_start is None:
        longest = max(map(len, images))
        length = segment_length_for(longest, segment_length=segment_length, segments=segments)
        cuts = _cut(joined, trajectory, length, parameters, progress)
    else:
        cuts = rows_of_cuts(images[0].scans, segment_start)
    grams: dict[str, FloatArray] | None = None
    if parameters.encoder.fits_to_grams:
        grams = {
            drive.name: projected.detail_gram(first_of_stands(drive.poses[projected.scans]))
            for drive, projected in zip(drives, images, strict=True)
        }
    tensor_map = fit_map(
        joined,
        trajectory,
        cuts,
        parameters,
        progress,
        _probes(images) if calibrated else None,
        kept=kept,
        grams=grams,
    )
    return Build(
        replace(tensor_map, placements=placements),
        sum(projected.returns for projected in images),
        {
            drive.name: Skipped.numbered(drive, projected.skipped)
            for drive, projected in zip(drives, images, strict=True)
        },
        () if kept is None or grams is None else kept.fits(grams),
        length,
    )


def project_scans(
    drive: Drive,
    scans: IntArray,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
    *,
    most_probes: int = PROBES,
    rendered: ProjectedDrive | None = None,
    new_buffer: NewBuffer = MemoryBuffer,
) -> DriveImages:
    """Project some scans of a drive, and probes of them.

    Args:
        drive: The drive.
        scans: Positions in it, rising.
        parameters: The map's.
        progress: Receives each scan.
        most_probes: How many probes to make; only a map that is calibrated needs them.
        rendered: Images of this drive by these parameters: those scans are not rendered again.
        new_buffer: Makes the buffer in which the images are kept.

    Raises:
        EmptyDrive: If not one of them is usable; the message has the first reason.
    """
    projected = project_drive(
        drive,
        scans,
        parameters.imager,
        progress,
        most_probes=most_probes,
        rendered=rendered,
        new_buffer=new_buffer,
    )
    return _WithDetailGram(**vars(projected))


def trajectory_of(drive: Drive, scans: IntArray) -> Trajectory:
    """Return the trajectory of the scans at these positions of a drive."""
    index = scan_index_of(drive)[scans]
    return Trajectory.of_drive(drive.name, drive.timestamp_s[scans], drive.poses[scans], index)


def cut_scans(
    drive: Drive,
    segment_length: int,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
    new_buffer: NewBuffer = MemoryBuffer,
    *,
    rendered: ProjectedDrive | None = None,
) -> tuple[IntArray, ProjectedDrive | None]:
    """Cut a whole drive before some of its scans are held out.

    Cuts of fixed length count every scan; unequal ones are found in the images of all usable ones,
    which are kept in a buffer; those in `rendered` are not rendered again.

    Returns:
        `(L + 1,)` positions where segments begin, and its length; the images, without probes, if
        they were needed.

    Raises:
        EmptyDrive: If the drive has no scan, or unequal cuts find no usable one.
        InvalidParameters: If the length is below 1.
    """
    if parameters.segmentation == Segmentation.FIXED:
        return cut_fixed(len(drive), segment_length), None
    every = np.arange(len(drive))
    images = project_drive(
        drive,
        every,
        parameters.imager,
        progress,
        most_probes=0,
        rendered=rendered,
        new_buffer=new_buffer,
    )
    scans = images.scans
    cuts = cut_unequal(images, trajectory_of(drive, scans), segment_length, parameters, progress)
    return np.concatenate([[0], scans[cuts[1:-1]], [len(drive)]]), images


def _cut(
    images: ImageSource,
    trajectory: Trajectory,
    segment_length: int,
    parameters: MapParameters,
    progress: Progress,
) -> IntArray:
    if parameters.segmentation == Segmentation.UNEQUAL:
        cuts = cut_unequal(images, trajectory, segment_length, parameters, progress)
    else:
        cuts = cut_drives(trajectory.drive_start, segment_length)
        # A cut costs nothing where all segments share a basis; otherwise each has one of its own,
        # and the paper's are of equal length.
        if parameters.encoder.shares_basis:
            cuts = cut_at_turns(trajectory, cuts)
    return cut_at_meetings(trajectory, cuts)


def rows_of_cuts(scans: IntArray, segment_start: IntArray) -> IntArray:
    """Return the rows at which segments begin in a map of some scans of a drive, `(L + 1,)`.

    Args:
        scans: Positions of the map's scans in the drive, rising.
        segment_start: `(L + 1,)` positions in the drive where segments begin, and its length.

    Raises:
        InvalidParameters: If a segment is left without a map scan.

    Examples:
        >>> rows_of_cuts(np.array([0, 2, 3, 7]), np.array([0, 3, 8])).tolist()
        [0, 2, 4]
    """
    cuts = np.searchsorted(scans, segment_start)
    empty = np.flatnonzero(np.diff(cuts) == 0)
    if len(empty):
        raise InvalidParameters(
            f"segment {empty[0]} is left without a map scan: take longer segments or another split"
        )
    return cuts


def _probes(images: Sequence[DriveImages]) -> Probes | None:
    """Return the probes of all drives; `None` if one has none, its returns being gone."""
    probed = [
        (projected.scans, projected.probed, projected.displacement, projected.probes)
        for projected in images
        if projected.probes is not None
    ]
    return Probes.of_drives(probed) if len(probed) == len(images) else None
