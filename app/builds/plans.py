"""What a build is to be made of: which drives in which order, and whose basis."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from app.builds.parameters import BuildParameters
from core.arrays import Float32Array
from core.encodings.basis import harmonic_basis_digest
from core.encodings.harmonic import HarmonicModel
from core.errors import EmptyDrive, InvalidParameters, UnknownDrive
from core.mapping.tensormap import TensorMap
from core.parameters import Encoding
from storage.catalog import DriveRecord, RevisionRecord
from storage.errors import CorruptFile, DriveNotFound, NoLiveRevision
from storage.files.map_file import read_revision
from storage.store import Store

__all__ = ["KeptBasis", "Plan", "plan_build"]


@dataclass(frozen=True, eq=False)
class KeptBasis:
    """The radial basis of an earlier revision.

    Attributes:
        revision: Digest of that revision.
        radial_basis: `(I, r1)` float32.
    """

    revision: str
    radial_basis: Float32Array


@dataclass(frozen=True, eq=False)
class Plan:
    """A build, with all that was left open chosen.

    Attributes:
        parameters: As asked for; with `base`, everything else that was built with there.
        drives: Which, in their order in the map; at least one, each has a scan.
        kept: The basis to keep, `None` to fit one.
        notes: What whoever asked for the build should know of the choice.
    """

    parameters: BuildParameters
    drives: tuple[str, ...]
    kept: KeptBasis | None
    notes: tuple[str, ...] = ()


def plan_build(store: Store, map_id: str, parameters: BuildParameters) -> Plan:
    """Choose the drives and the basis of a build.

    A build of all drives leaves out those without a scan, as a mistyped name makes with its poses.
    A harmonic map keeps the basis of the revision that it is based on, or else of the live one if
    that makes the same signatures of a scan, unless `refit` asks for another.

    Raises:
        MapNotFound: If the map is gone.
        NoLiveRevision: If the build is based on the live revision and there is none.
        RevisionNotFound: If it is based on one that is not there.
        AmbiguousRevision: If the map has several revisions of that prefix.
        UnknownDrive: If a drive is to be left out that the base does not have.
        DriveNotFound: If the map lacks one of the drives.
        EmptyDrive: If no drive is left, or one that is named has no scan.
        InvalidParameters: If parameters do not fit, or differ from the base's.
        CorruptFile: If the file of the revision whose basis would be kept is damaged.
    """
    if parameters.base is None:
        parameters.map_parameters()  # refuses what does not fit, before anything is read
    base = _base(store, map_id, parameters)
    names: Sequence[str]
    notes: tuple[str, ...] = ()
    if base is None:
        names = parameters.drives or ()
        if not names:
            names, notes = _all_with_scans(store, map_id)
        names = _young(store, map_id, names, parameters.max_age_days)
    else:
        record, base_map = base
        parameters = parameters.on_base(record.digest, record.parameters)
        if parameters.map_parameters() != base_map.parameters:
            raise InvalidParameters(
                f"base {record.digest[:12]} was built with parameters that its record does not"
                " tell: build without base"
            )
        names = _changed(store, map_id, base_map, parameters)
    drives = _stored(store, map_id, names)
    kept = None
    if parameters.encoding == Encoding.HARMONIC and not parameters.refit:
        try:
            kept = _kept(base or _live(store, map_id), parameters)
        except CorruptFile as error:
            raise CorruptFile(
                f"{error}: a build keeps the basis of the live revision, which cannot be read. Send"
                " refit: true to fit a new basis, which vehicles then download; or, to keep one,"
                " first make a revision live whose file is good, imported or built before"
            ) from error
    return Plan(parameters, tuple(drive.slug for drive in drives), kept, notes)


def _base(
    store: Store, map_id: str, parameters: BuildParameters
) -> tuple[RevisionRecord, TensorMap] | None:
    if parameters.base is None:
        return None
    if parameters.base != "live":
        return _read(store, store.revisions.of_map(map_id, parameters.base))
    live = _live(store, map_id)
    if live is None:
        slug = store.maps.get_by_id(map_id).slug
        raise NoLiveRevision(f"map {slug!r} has no revision to base a build on: build without base")
    return live


def _live(store: Store, map_id: str) -> tuple[RevisionRecord, TensorMap] | None:
    digest = store.maps.get_by_id(map_id).live_revision
    return None if digest is None else _read(store, store.revisions.of_map(map_id, digest))


def _read(store: Store, record: RevisionRecord) -> tuple[RevisionRecord, TensorMap]:
    try:
        return record, read_revision(store.revisions.path_of(record), record.digest)
    except FileNotFoundError as error:
        raise CorruptFile(f"the file of revision {record.digest} is gone") from error


def _all_with_scans(store: Store, map_id: str) -> tuple[Sequence[str], tuple[str, ...]]:
    """Return the drives of a map that have scans, and a note on each other one."""
    drives = store.drives.of_map(map_id)
    notes = []
    for drive in drives:
        if not drive.scans:
            waiting = (
                f", {drive.expected_poses} poses wait for them" if drive.expected_poses else ""
            )
            notes.append(
                f"drive {drive.slug} is left out, it has no scans{waiting}: is its name mistyped?"
            )
    return [drive.slug for drive in drives if drive.scans], tuple(notes)


def _changed(
    store: Store, map_id: str, base: TensorMap, parameters: BuildParameters
) -> Sequence[str]:
    """Return the base's drives without those to remove, then those to add."""
    of_base = base.trajectory.drives
    added, removed = parameters.add or [], parameters.remove or []
    unknown = [name for name in removed if name not in of_base]
    if unknown:
        raise UnknownDrive(
            f"base {base.revision[:12]} has no drive {unknown[0]!r}, it has {', '.join(of_base)}"
        )
    stays = [name for name in of_base if name not in {*added, *removed}]
    stored = {drive.slug for drive in store.drives.of_map(map_id)}
    gone = [name for name in stays if name not in stored]
    if gone:
        raise DriveNotFound(
            f"drive {gone[0]!r} of base {base.revision[:12]} is no longer stored: upload it again,"
            " or name it in remove"
        )
    return _young(store, map_id, [*stays, *added], parameters.max_age_days)


def _young(
    store: Store, map_id: str, names: Sequence[str], max_age_days: float | None
) -> Sequence[str]:
    if max_age_days is None or not names:
        return names
    since = datetime.now(UTC) - timedelta(days=max_age_days)
    drives = store.drives.of_map(map_id, names)
    young = [drive.slug for drive in drives if drive.created_at >= since]
    if not young:
        raise EmptyDrive(f"no drive of {len(names)} is younger than {max_age_days:g} days")
    return young


def _stored(store: Store, map_id: str, names: Sequence[str]) -> Sequence[DriveRecord]:
    if not names:
        slug = store.maps.get_by_id(map_id).slug
        scans = any(drive.scans for drive in store.drives.of_map(map_id))
        reason = "no drive would be left" if scans else "upload scans first"
        raise EmptyDrive(f"map {slug!r} has no drive to build of: {reason}")
    drives = store.drives.of_map(map_id, names)
    empty = [drive.slug for drive in drives if not drive.scans]
    if empty:
        raise EmptyDrive(f"drive {empty[0]!r} has no scan")
    return drives


def _kept(
    earlier: tuple[RevisionRecord, TensorMap] | None, parameters: BuildParameters
) -> KeptBasis | None:
    if earlier is None:
        return None
    record, tensor_map = earlier
    if not isinstance(tensor_map.model, HarmonicModel):
        return None
    u = tensor_map.model.radial_basis
    if harmonic_basis_digest(parameters.map_parameters(), u) != tensor_map.basis_digest:
        return None  # another grid, reducer or rank: signatures would differ anyway
    return KeptBasis(record.digest, u)
