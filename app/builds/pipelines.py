"""What routes, jobs and commands do: siblings over these functions."""

import logging
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from app.builds.live_gate import Gate, pass_gate
from app.builds.parameters import BuildParameters, PoseCheck
from app.builds.plans import KeptBasis, Plan, plan_build
from app.drives.stored_images import images_path, open_images
from core.arrays import Float32Array, FloatArray
from core.frames.agreement import FrameCheck, check_frames, require_one_frame
from core.mapping.build import build_map
from core.mapping.merge import BasisFit, basis_fits
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters, Segmentation
from core.progress import NO_PROGRESS, Progress
from core.projection.images import ConcatenatedImages, Probes, Skipped
from core.scans.drive import Drive
from core.scans.trajectory import Trajectory
from core.segmentation import cut_drives, cut_unequal, segment_length_for
from core.topology import cut_at_meetings
from storage.catalog import Act, RevisionFacts, RevisionRecord, on_behalf
from storage.catalog.scans import LostRace
from storage.errors import CorruptImages, DriveNotFound, StorageBusy
from storage.files.image_file import ImageFile, write_image_file
from storage.files.map_file import write_map
from storage.store import Store, StoredDrive

_log = logging.getLogger("tensormap.builds")

_ATTEMPTS = 20  # each lost race is another revision that became live

__all__ = ["Built", "build_drive", "build_drives", "build_revision"]


@dataclass(frozen=True, eq=False)
class Built:
    """A map and what its drives were.

    Attributes:
        tensor_map: The map.
        returns: How many returns its scans held together.
        skipped: Scans that could not be used, by drive.
        fits: How well a basis that was kept fits each drive; none if it was fitted.
        segment_length: k that drives were cut with.
        frames: What is known of the world frames of the drives after the first.
    """

    tensor_map: TensorMap
    returns: int
    skipped: dict[str, tuple[Skipped, ...]]
    fits: tuple[BasisFit, ...]
    segment_length: int
    frames: tuple[FrameCheck, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What whoever asked for the build should know."""
        return (
            *(f"{fit}: consider to fit it anew" for fit in self.fits if fit.much_worse),
            *(note for check in self.frames if (note := check.note) is not None),
        )


def build_revision(
    store: Store,
    map_id: str,
    parameters: BuildParameters,
    progress: Progress = NO_PROGRESS,
    *,
    job_id: str | None = None,
) -> RevisionRecord:
    """Build a revision of a stored map and publish it.

    Images are kept beside the drive: another build with the same projection reads no raw return.
    Should they turn out to be damaged, they are made anew, once, if the returns are there. The map
    is the one of this id to the end, whatever becomes of its slug.

    Raises:
        MapNotFound: If the map is gone, also if that happens during the build.
        DriveNotFound: If the map lacks one of the drives, or no longer has it.
        EmptyDrive: If it has no drive, or one has no usable scan.
        ReturnsGone: If images are not kept, and the returns that they are made of were dropped.
        FramesDisagree: If the poses of two drives are in different world frames.
        Cancelled: If `progress` says so; nothing is published.
        TensorMapError: What `app.builds.plans.plan_build` raises.
    """
    plan = plan_build(store, map_id, parameters)
    drives = store.drives.open_of_map(map_id, plan.drives)
    map_parameters = plan.parameters.map_parameters()
    try:
        built = _build_stored(store, drives, plan, map_parameters, progress)
    except CorruptImages as error:
        _log.warning("%s; the images are made anew from the raw returns", error)
        for drive in drives:
            if drive.has_returns.all():
                images_path(store, drive, map_parameters).unlink(missing_ok=True)
        built = _build_stored(store, drives, plan, map_parameters, progress)
    left_over: list[str] = []
    with suppress(DriveNotFound):  # deleted meanwhile: what was built of it stays
        left_over = [
            f"drive {drive.slug} has {drive.expected_poses} poses of scans that it lacks: are they"
            " another drive's?"
            for drive in store.drives.of_map(map_id, plan.drives)
            if drive.expected_poses
        ]
    for _ in range(_ATTEMPTS):
        gate = None
        if parameters.make_live:
            progress.start("comparing", 1)
            ids = {drive.name: drive.id for drive in drives}
            gate = pass_gate(store, map_id, ids, built.tensor_map, parameters)
            progress.advance()
        facts = _facts(drives, plan, map_parameters, built, gate, left_over, job_id)
        try:
            return _publish(store, map_id, built.tensor_map, facts, gate)
        except LostRace as error:
            _log.info("%s: the build is compared with that one", error)
    raise StorageBusy(f"another revision became live {_ATTEMPTS} times while one was compared")


def _facts(
    drives: Sequence[StoredDrive],
    plan: Plan,
    map_parameters: MapParameters,
    built: Built,
    gate: Gate | None,
    left_over: Sequence[str],
    job_id: str | None,
) -> RevisionFacts:
    tensor_map = built.tensor_map
    notes = (*plan.notes, *left_over, *built.notes)
    if gate is not None and gate.reason is not None:
        notes = (*notes, gate.reason)
    return RevisionFacts(
        encoding=map_parameters.encoding,
        scans=len(tensor_map),
        segments=tensor_map.model.segments,
        parameters={
            **plan.parameters.as_json(),
            **_resolved(map_parameters),
            "drives": list(plan.drives),
            "segment_length": built.segment_length,
            "basis": _provenance(tensor_map, plan.kept, built.fits),
            "returns": built.returns,
            "calibrated": tensor_map.calibration is not None,
            "skipped": {name: len(skipped) for name, skipped in built.skipped.items() if skipped},
        },
        job_id=job_id,
        bases=tensor_map.basis_digests,
        notes=notes,
        drive_ids={drive.name: drive.id for drive in drives},
        job_result={} if gate is None else {"gate": gate.as_json()},
    )


def _publish(
    store: Store, map_id: str, tensor_map: TensorMap, facts: RevisionFacts, gate: Gate | None
) -> RevisionRecord:
    act = Act(
        "service",
        "publish_revision",
        "the store" if facts.job_id is None else f"/v1/jobs/{facts.job_id}",
        store.maps.get_by_id(map_id).slug,
        f"revision {tensor_map.revision}",
    )
    with on_behalf(act):
        return store.revisions.add(
            map_id,
            tensor_map.revision,
            lambda path: write_map(path, tensor_map),
            facts,
            make_live=gate is not None and gate.live,
            if_live=None if gate is None else gate.if_live,
        )


def build_drive(
    drive: Drive, parameters: BuildParameters, progress: Progress = NO_PROGRESS
) -> Built:
    """Build a map of one drive; see `build_drives`."""
    return build_drives([drive], parameters, progress)


def build_drives(
    drives: Sequence[Drive],
    parameters: BuildParameters,
    progress: Progress = NO_PROGRESS,
    *,
    radial_basis: Float32Array | None = None,
) -> Built:
    """Build a map of drives of any length: their images pass through temporary files.

    Args:
        drives: No two of one name.
        parameters: How; only what tells the map's own parameters and cuts.
        progress: Told of every scan.
        radial_basis: U to keep, of a harmonic map.

    Raises:
        EmptyDrive: If a drive has no usable scan.
        InvalidParameters: If a parameter does not fit.
        InvalidMap: If two drives have one name.
        FramesDisagree: If the poses of two drives are in different world frames.
    """
    map_parameters = parameters.map_parameters()
    with TemporaryDirectory(prefix="tensormap-") as folder, ExitStack() as stack:
        images = []
        for position, drive in enumerate(drives):
            path = Path(folder) / f"{position}.h5"
            write_image_file(path, drive, map_parameters.imager, progress)
            images.append(stack.enter_context(ImageFile(path, map_parameters.imager)))
        return _build(drives, images, parameters, map_parameters, progress, radial_basis)


def _build_stored(
    store: Store,
    drives: Sequence[StoredDrive],
    plan: Plan,
    map_parameters: MapParameters,
    progress: Progress,
) -> Built:
    with ExitStack() as stack:
        images = [
            stack.enter_context(open_images(store, drive, map_parameters, progress))
            for drive in drives
        ]
        kept = None if plan.kept is None else plan.kept.radial_basis
        return _build(drives, images, plan.parameters, map_parameters, progress, kept)


def _build(
    drives: Sequence[Drive],
    images: Sequence[ImageFile],
    parameters: BuildParameters,
    map_parameters: MapParameters,
    progress: Progress,
    radial_basis: Float32Array | None = None,
) -> Built:
    trajectory = Trajectory.concatenate(
        [_trajectory(drive, of_it) for drive, of_it in zip(drives, images, strict=True)]
    )
    longest = max(len(of_it) for of_it in images)
    length = segment_length_for(
        longest, segment_length=parameters.segment_length, segments=parameters.segments
    )
    joined = ConcatenatedImages(images)
    cuts = (
        cut_unequal(joined, trajectory, length, map_parameters, progress)
        if map_parameters.segmentation == Segmentation.UNEQUAL
        else cut_drives(trajectory.drive_start, length)
    )
    grams: dict[str, FloatArray] | None = None
    if map_parameters.distance is not None:
        grams = {d.name: i.detail_gram() for d, i in zip(drives, images, strict=True)}
    tensor_map = build_map(
        joined,
        trajectory,
        cut_at_meetings(trajectory, cuts),
        map_parameters,
        progress,
        _probes(images),
        radial_basis=radial_basis,
        grams=grams,
    )
    frames: tuple[FrameCheck, ...] = ()
    if parameters.poses == PoseCheck.CHECKED:
        frames = check_frames(tensor_map, progress)
        require_one_frame(frames)
    fits = () if radial_basis is None or grams is None else basis_fits(radial_basis, grams)
    return Built(
        tensor_map,
        sum(of_it.returns for of_it in images),
        {drive.name: of_it.skipped for drive, of_it in zip(drives, images, strict=True)},
        fits,
        length,
        frames,
    )


def _probes(images: Sequence[ImageFile]) -> Probes | None:
    """Return the probes of all drives; `None` if one has none, its returns being gone."""
    told = [
        (of_it.scans, of_it.probed, of_it.standing, of_it.probes)
        for of_it in images
        if of_it.probes is not None
    ]
    return Probes.of_drives(told) if len(told) == len(images) else None


def _trajectory(drive: Drive, images: ImageFile) -> Trajectory:
    scans = images.scans
    index = drive.scan_index[scans] if isinstance(drive, StoredDrive) else scans
    return Trajectory.of_drive(drive.name, drive.timestamp_s[scans], drive.poses[scans], index)


def _provenance(
    tensor_map: TensorMap, kept: KeptBasis | None, fits: Sequence[BasisFit]
) -> dict[str, Any]:
    """Tell where the basis comes from, and how well it fits what it was not fitted to."""
    return {
        "digest": tensor_map.basis_digest,
        "kept_from": None if kept is None else kept.revision,
        "fits": [
            {
                "drive": fit.drive,
                "kept_error": round(fit.kept_error, 6),
                "refitted_error": round(fit.refitted_error, 6),
            }
            for fit in fits
        ],
    }


def _resolved(parameters: MapParameters) -> dict[str, Any]:
    """Return what was chosen for options that were left open."""
    offsets = parameters.lateral_renderings_m
    return {
        "reducer": parameters.reducer.value,
        "image": parameters.image.value,
        "distance": None if parameters.distance is None else parameters.distance.value,
        "lateral_renderings_m": None if offsets is None else list(offsets),
    }
