"""What routes, jobs and commands do: siblings over these functions."""

import logging
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from app.builds.live_gate import Gate, pass_gate
from app.builds.parameters import BuildParameters, PoseCheck
from app.builds.plans import Plan, unreadable_basis
from app.drives.stored_images import images_path, open_images
from core.encodings.basis import Basis, BasisFit
from core.frames.agreement import FrameCheck, check_frames, require_one_frame
from core.mapping.pipeline import Build, ImagesOf, build
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from storage.catalog import Act, RevisionFacts, RevisionRecord, on_behalf
from storage.catalog.scans import LostRace
from storage.errors import CorruptFile, CorruptImages, DriveNotFound, StorageBusy
from storage.files.image_file import ImageFile, write_image_file
from storage.files.map_file import read_revision, write_map
from storage.store import Store, StoredDrive

_log = logging.getLogger("tensormap.builds")

_ATTEMPTS = 20  # each lost race is another revision that became live


@dataclass(frozen=True, eq=False)
class Built(Build):
    """A map and what its drives were.

    Attributes:
        frames: What is known of the world frames of the drives after the first.
    """

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
    plan: Plan,
    progress: Progress = NO_PROGRESS,
    *,
    job_id: str | None = None,
) -> RevisionRecord:
    """Build a revision of a stored map as planned, and publish it.

    Images are kept beside the drive: another build with the same projection reads no raw return.
    Should they turn out to be damaged, they are made anew, once, if the returns are there. The map
    is the one of this id to the end, whatever becomes of its slug.

    Raises:
        MapNotFound: If the map is gone, also if that happens during the build.
        DriveNotFound: If the map lacks one of the drives, or no longer has it.
        EmptyDrive: If one has no usable scan.
        RevisionNotFound: If the revision whose basis is kept was deleted.
        CorruptFile: If its file is damaged.
        ReturnsGone: If images are not kept, and the returns that they are made of were dropped.
        FramesDisagree: If the poses of two drives are in different world frames.
        Cancelled: If `progress` says so; nothing is published.
    """
    drives = store.drives.open_of_map(map_id, plan.drives)
    parameters = plan.parameters
    map_parameters = parameters.map_parameters()
    kept = _kept_basis(store, map_id, plan)
    try:
        built = _build_stored(store, drives, plan, map_parameters, progress, kept)
    except CorruptImages as error:
        _log.warning("%s; the images are made anew from the raw returns", error)
        for drive in drives:
            if drive.has_returns.all():
                images_path(store, drive, map_parameters).unlink(missing_ok=True)
        built = _build_stored(store, drives, plan, map_parameters, progress, kept)
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


def _kept_basis(store: Store, map_id: str, plan: Plan) -> Basis | None:
    """Return the basis that the plan keeps, `None` if it fits one."""
    if plan.basis_kept_from is None:
        return None
    record = store.revisions.of_map(map_id, plan.basis_kept_from)
    try:
        kept = read_revision(store.revisions.path_of(record), record.digest)
    except FileNotFoundError as error:
        raise CorruptFile(f"the file of revision {record.digest} is gone") from error
    except CorruptFile as error:
        raise unreadable_basis(error) from error
    return kept.basis()


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
            "drives": plan.drives,
            "segment_length": built.segment_length,
            "basis": _provenance(tensor_map, plan.basis_kept_from, built.fits),
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


def build_drives(
    drives: Sequence[Drive],
    parameters: BuildParameters,
    progress: Progress = NO_PROGRESS,
    *,
    kept: Basis | None = None,
) -> Built:
    """Build a map of drives of any length: their images pass through temporary files.

    Args:
        drives: No two of one name.
        parameters: How; only what tells the map's own parameters and cuts.
        progress: Told of every scan.
        kept: The basis of another map, to keep.

    Raises:
        EmptyDrive: If a drive has no usable scan.
        InvalidParameters: If a parameter does not fit.
        InvalidMap: If two drives have one name.
        FramesDisagree: If the poses of two drives are in different world frames.
    """
    imager = parameters.map_parameters().imager
    with ExitStack() as stack:

        def images_of(drive: Drive) -> ImageFile:
            folder = stack.enter_context(TemporaryDirectory(prefix="tensormap-"))
            path = Path(folder) / "images.h5"
            write_image_file(path, drive, imager, progress)
            return stack.enter_context(ImageFile(path, imager))

        return _build(drives, images_of, parameters, progress, kept)


def _build_stored(
    store: Store,
    drives: Sequence[StoredDrive],
    plan: Plan,
    map_parameters: MapParameters,
    progress: Progress,
    kept: Basis | None,
) -> Built:
    images = {drive.name: partial(open_images, store, drive) for drive in drives}
    with ExitStack() as stack:

        def images_of(drive: Drive) -> ImageFile:
            return stack.enter_context(images[drive.name](map_parameters, progress))

        return _build(drives, images_of, plan.parameters, progress, kept)


def _build(
    drives: Sequence[Drive],
    images_of: ImagesOf,
    parameters: BuildParameters,
    progress: Progress,
    kept: Basis | None,
) -> Built:
    made = build(
        drives,
        parameters.map_parameters(),
        images_of,
        segment_length=parameters.segment_length,
        segments=parameters.segments,
        kept=kept,
        progress=progress,
    )
    if parameters.poses == PoseCheck.UNCHECKED:
        return Built(**vars(made))
    frames = check_frames(made.tensor_map, progress)
    require_one_frame(frames)
    return Built(**vars(made), frames=frames)


def _provenance(
    tensor_map: TensorMap, kept_from: str | None, fits: Sequence[BasisFit]
) -> dict[str, Any]:
    """Tell where the basis comes from, and how well it fits what it was not fitted to."""
    return {
        "digest": tensor_map.basis_digest,
        "kept_from": kept_from,
        "fits": [
            {
                "drive": fit.drive,
                "kept_error": round(fit.kept_error, 6),
                "refitted_error": round(fit.refitted_error, 6),
            }
            for fit in fits
        ],
    }
