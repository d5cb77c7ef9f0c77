"""Builds of revisions of stored maps, as jobs run them."""

import logging
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from app.builds.anchor_notes import anchor_notes
from app.builds.drive_build import Built, build_mapped, with_fitting_segments
from app.builds.drive_notes import drive_notes, left_out_notes
from app.builds.live_gate import Gate, pass_gate
from app.builds.mounting_notes import mounting_notes
from app.builds.parameters import BuildParameters
from app.builds.placed_poses import kept_placements, placed_poses
from app.builds.plans import Plan, unreadable_basis
from app.builds.pose_checks import check_stored
from app.builds.recall import DrivenMap
from app.builds.stored_odometry import pose_stored
from app.drives.mapped_drives import mapped_drive
from app.drives.stored_images import images_path, open_images
from core.encodings.basis import Basis
from core.mapping.tensormap import TensorMap
from core.progress import NO_PROGRESS, Progress
from core.scans.pose import PoseSource
from core.text import count_of
from storage.catalog import SERVICE_ID, Act, FilledDrive, RevisionFacts, RevisionRecord, on_behalf
from storage.errors import CorruptFile, CorruptImages, DriveNotFound, LostRace, StorageBusy
from storage.files.map_file import write_map
from storage.store import Store, StoredDrive

_log = logging.getLogger("tensormap.builds")

_ATTEMPTS = 20  # each lost race is another revision that became live


def build_revision(
    store: Store,
    map_id: str,
    plan: Plan,
    progress: Progress = NO_PROGRESS,
    *,
    job_id: str | None = None,
) -> RevisionRecord:
    """Build a revision of a stored map as planned, and publish it.

    Images are kept beside the drive: another build with the same projection, of the same poses,
    reads no raw return but those of some scans that show where the ground is.
    Damaged ones are projected again, once, if the returns are there. The map is the one of this id
    to the end, also if it is renamed.

    Raises:
        MapNotFound: If the map was deleted, also during the build.
        DriveNotFound: If the map lacks one of the drives, or no longer has it.
        EmptyDrive: If one has no usable scan.
        RevisionNotFound: If the revision whose basis is kept was deleted.
        BasisNotFound: If the shared basis was deleted.
        CorruptFile: If its file is damaged.
        ReturnsGone: If images are not kept, and the returns for them were dropped.
        FramesDisagree: If the poses of two drives are in different world frames.
        PosesContradictScans: If the poses of a drive are not those of its scans.
        Cancelled: If `progress` raises it; nothing is published.
    """
    drives: Sequence[StoredDrive] = store.drives.open_of_map(map_id, plan.drives)
    kept = _kept_basis(store, map_id, plan)
    parameters = plan.parameters
    map_parameters = parameters.map_parameters()
    height_m = map_parameters.sensor_height_m
    notes = [
        *plan.notes,
        *check_stored(store, drives, height_m, parameters.align, progress),
        *mounting_notes([(d, d.mounting) for d in drives], height_m),
    ]
    if parameters.odometry:
        drives, of_odometry = pose_stored(store, map_id, drives, height_m, progress)
        notes += of_odometry
    placements, of_placements = kept_placements(plan, drives)
    notes += of_placements
    stored = {drive.name: drive for drive in drives}
    mapped = [mapped_drive(drive, height_m) for drive in drives]
    build_stored = partial(
        build_mapped,
        mapped,
        lambda drive: open_images(store, stored[drive.name], map_parameters, progress),
        with_fitting_segments(parameters, mapped) if plan.fits_segments else parameters,
        progress,
        kept,
        placements=placements,
        frameless=[drive.name for drive in drives if drive.pose_source == PoseSource.ODOMETRY],
        confirmed=plan.confirmed_frames,
    )
    try:
        built = build_stored()
    except CorruptImages as error:
        _log.warning("%s; the images are projected again from the raw returns", error)
        for drive in drives:
            if drive.has_returns.all():
                images_path(store, drive, map_parameters).unlink(missing_ok=True)
        built = build_stored()
    notes += (
        *_notes_on_expected_poses(_stored_now(store, map_id, drives)),
        *left_out_notes(built, {drive.name: drive.accumulate for drive in drives}),
        *drive_notes(built.tensor_map, drives),
        *anchor_notes(store, map_id, built.tensor_map),
        *built.notes,
    )
    facts = _facts(plan, built, drives, notes, job_id)
    return _publish(store, map_id, built.tensor_map, parameters, facts, progress)


def _kept_basis(store: Store, map_id: str, plan: Plan) -> Basis | None:
    """Return the basis that the plan uses or keeps, `None` if it fits one."""
    if plan.basis is not None:
        return store.bases.read(plan.basis)
    if plan.basis_kept_from is None:
        return None
    record = store.revisions.of_map(map_id, plan.basis_kept_from)
    try:
        return store.revisions.read(record).basis()
    except CorruptFile as error:
        raise unreadable_basis(error) from error


def _facts(
    plan: Plan,
    built: Built,
    drives: Sequence[StoredDrive],
    notes: Sequence[str],
    job_id: str | None,
) -> RevisionFacts:
    """Return what the catalog keeps of a built revision."""
    tensor_map = built.tensor_map
    return RevisionFacts(
        encoding=tensor_map.parameters.encoding,
        scans=len(tensor_map),
        segments=tensor_map.model.segments,
        parameters={
            **plan.parameters.as_json(),
            "drives": plan.drives,
            "segment_length": built.segment_length,
            "basis": _origin_of_basis(plan, built),
            "returns": built.returns,
            "verification_bytes": tensor_map.verification_bytes,
            "calibrated": tensor_map.calibration is not None,
            "skipped": {name: len(skipped) for name, skipped in built.skipped.items() if skipped},
            "placements": tensor_map.attributes().get("placements", {}),
            "placed_poses": placed_poses(tensor_map.placements, drives),
            "confirmed_frames": dict(built.confirmed_frames),
            **_setups(drives),
        },
        job_id=job_id,
        bases=tensor_map.basis_digests,
        notes=tuple(notes),
        drive_ids={drive.name: drive.id for drive in drives},
    )


def _origin_of_basis(plan: Plan, built: Built) -> dict[str, Any]:
    """Return which basis a map has, whose it is, and how well it fits each drive."""
    return {
        "digest": built.tensor_map.basis_digest,
        "kept_from": plan.basis_kept_from,
        **({} if plan.basis is None else {"shared": plan.parameters.basis}),
        "fits": [
            {
                "drive": fit.drive,
                "kept_error": round(fit.kept_error, 6),
                "refitted_error": round(fit.refitted_error, 6),
            }
            for fit in built.fits
        ],
    }


def _notes_on_expected_poses(drives: Sequence[FilledDrive]) -> list[str]:
    """Return a note on each drive that has poses of scans that it lacks."""
    return [
        f"drive {drive.slug} has {count_of(drive.expected_poses, 'pose')} of scans that it lacks:"
        f" {'is it' if drive.expected_poses == 1 else 'are they'} another drive's?"
        for drive in drives
        if drive.expected_poses
    ]


def _stored_now(store: Store, map_id: str, drives: Sequence[StoredDrive]) -> Sequence[FilledDrive]:
    """Return drives as they are now, with the scans and poses that they got meanwhile.

    Raises:
        DriveNotFound: If one was deleted, also if its name was given to another one.
    """
    found = store.drives.of_map(map_id, [drive.name for drive in drives])
    for drive, now in zip(drives, found, strict=True):
        if now.id != drive.id:
            raise DriveNotFound(f"drive {drive.name!r} is another one than the build has read")
    return found


def _publish(
    store: Store,
    map_id: str,
    tensor_map: TensorMap,
    parameters: BuildParameters,
    facts: RevisionFacts,
    progress: Progress,
) -> RevisionRecord:
    """Add the revision to the map, and make it live if that is requested and the gate is passed."""
    subject = "the store" if facts.job_id is None else f"/v1/jobs/{facts.job_id}"
    detail = f"revision {tensor_map.revision}" + ", with force" * parameters.force
    for _ in range(_ATTEMPTS):
        gate = None
        if parameters.make_live:
            progress.start("comparing", 1)
            gate = pass_gate(store, map_id, DrivenMap(facts.drive_ids, tensor_map), parameters)
            progress.advance()
        slug = store.maps.get_by_id(map_id).slug
        try:
            with on_behalf(Act(SERVICE_ID, "publish_revision", subject, slug, detail)):
                return store.revisions.add(
                    map_id,
                    tensor_map.revision,
                    lambda path: write_map(path, tensor_map),
                    facts if gate is None else _with_gate(facts, gate),
                    make_live=gate is not None and gate.live,
                    if_live=None if gate is None else gate.if_live,
                )
        except LostRace as error:
            _log.info("%s: the build is compared with that one", error)
    raise StorageBusy(f"another revision became live {_ATTEMPTS} times while one was compared")


def _with_gate(facts: RevisionFacts, gate: Gate) -> RevisionFacts:
    """Return the facts with the gate's result, and its reason among the notes."""
    notes = facts.notes if gate.reason is None else (*facts.notes, gate.reason)
    return replace(facts, notes=notes, job_result={"gate": gate.as_json()})


def _setups(drives: Sequence[StoredDrive]) -> dict[str, Any]:
    """Return how drives are read where it is not plain: mountings, scans in one, odometry."""
    found = {
        "mountings": {d.name: asdict(d.mounting) for d in drives if d.mounting is not None},
        "accumulate": {d.name: d.accumulate for d in drives if d.accumulate != 1},
        "odometry_of": {d.name: dict(d.odometry) for d in drives if d.odometry is not None},
    }
    return {name: of_drives for name, of_drives in found.items() if of_drives}
