"""Plans of builds: which drives in which order, and whose basis."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, field_validator

from app.builds.parameters import Align, BuildParameters
from core.encodings.basis import Basis, make_same_signatures, signature_parameters
from core.errors import EmptyDrive, InvalidParameters, UnknownDrive
from core.mapping.components import placements_without
from core.mapping.placement import Placement
from core.parameters import MapParameters
from core.projection.imager import Views
from core.segmentation.fitting import require_segments
from storage.catalog import FilledDrive, RevisionRecord
from storage.errors import CorruptFile, DriveNotFound, NoLiveRevision
from storage.store import Store


class Plan(BaseModel):
    """A build with all its choices made when it was queued."""

    model_config = ConfigDict(frozen=True)

    drives: list[str] = Field(description="The drives that it is built from, in their order.")
    basis_kept_from: str | None = Field(
        description="The revision whose basis it keeps; null if it fits one."
    )
    basis: str | None = Field(
        None, description="Digest of the shared basis that it uses; null if it uses none."
    )
    parameters: BuildParameters = Field(
        description="The requested ones, with defaults filled in; with `base`, those of that"
        " revision."
    )
    notes: list[str] = Field(description="Notes on these choices for the client.")
    fits_segments: bool = Field(
        default=False,
        description="Whether the length of segments is chosen by that of the longest drive; false"
        " where it was given, and for a build that an earlier version queued.",
    )
    placements: dict[str, dict[str, Any]] = Field(
        default_factory=dict,
        description="The transforms of poses in the base, by drive: they stay, but of drives in"
        " `add`.",
    )
    placed_poses: dict[str, dict[str, Any]] = Field(
        default_factory=dict,
        description="Which poses these transform, by drive: the last scan, and the digest of the"
        " poses up to it. A transform is not applied to others.",
    )
    confirmed_frames: dict[str, str] = Field(
        default_factory=dict,
        description="The digests of the poses of the base's drives, if all of them were found in"
        " one world frame: with the same poses they are not matched again.",
    )

    @field_validator("parameters", mode="before")
    @classmethod
    def _of_an_earlier_release(cls, parameters: object) -> object:
        """Take plans that were stored when full views were the only ones as they were meant."""
        if isinstance(parameters, Mapping):
            return {"views": Views.FULL.value, "verification_images": False, **parameters}
        return parameters


class _Revision(NamedTuple):
    """A revision, and the parameters and drives of its file."""

    record: RevisionRecord
    parameters: MapParameters
    drives: Mapping[str, Placement | None]

    @property
    def placements(self) -> dict[str, Placement]:
        """The transforms of those drives whose poses were transformed."""
        return {name: placed for name, placed in self.drives.items() if placed is not None}


def plan_build(store: Store, map_id: str, parameters: BuildParameters) -> Plan:
    """Choose the drives and the basis of a build, from the catalog and the heads of files.

    A build of all drives leaves out those without a scan: poses under a mistyped name create such a
    drive. A harmonic map keeps the basis of the revision that it is based on, or else of the live
    one if that makes the same signatures of a scan, unless `refit` is set.

    Raises:
        MapNotFound: If the map was deleted.
        NoLiveRevision: If the build is based on the live revision and there is none.
        RevisionNotFound: If it is based on an unknown one.
        AmbiguousRevision: If the map has several revisions of that prefix.
        UnknownDrive: If a drive of `remove` is not in the base.
        DriveNotFound: If the map lacks one of the drives.
        EmptyDrive: If no drive is left, or a named one has no scan.
        InvalidParameters: If parameters do not fit, or differ from those of the base or the shared
            basis.
        BasisNotFound: If there is no such shared basis.
        CorruptFile: If the file of the revision whose basis would be kept is damaged.
    """
    notes: list[str] = []
    base: _Revision | None = None
    shared = None if parameters.basis is None else store.bases.read(parameters.basis)
    if parameters.base is None:
        if shared is not None:
            parameters = _with_views_of_basis(shared, parameters)
        parameters = _with_views_of_live(store, map_id, parameters)
        of_map = parameters.map_parameters()  # rejects what does not fit, before a drive is read
        names: Sequence[str] = parameters.drives or ()
        if not names:
            names, notes = _all_with_scans(store, map_id)
    else:
        base = _base(store, map_id, parameters.base)
        parameters = parameters.on_base(base.record.digest, base.record.parameters)
        of_map = parameters.map_parameters()
        if of_map != base.parameters:
            raise InvalidParameters(
                f"base {base.record.digest[:12]} was built with other parameters than its record"
                " has: build without base"
            )
        names = _changed(store, map_id, base, parameters)
    drives = _stored(store, map_id, names, parameters.max_age_days)
    require_segments(
        max(_mapped_scans(drive) for drive in drives),
        # That of a base may be 1, of a drive of one scan; its other drives have it too.
        segment_length=parameters.segment_length if base is None else None,
        segments=parameters.segments,
    )
    basis_kept_from = None
    if shared is not None:
        _require_serves(shared, of_map)
    elif of_map.encoder.shares_basis and not parameters.refit:
        basis_kept_from = _basis_kept_from(store, map_id, base, of_map)
    names = [drive.slug for drive in drives]
    notes += _notes_on_named(base, names, parameters)
    notes += _notes_on_replaced(base, drives, parameters)
    return Plan(
        drives=names,
        basis_kept_from=basis_kept_from,
        basis=None if shared is None else shared.digest,
        parameters=parameters.resolved(),
        fits_segments=parameters.segment_length is None and parameters.segments is None,
        notes=[*notes, *parameters.assumptions],
        **({} if base is None else _placed(base, drives, parameters)),
    )


def _notes_on_named(
    base: _Revision | None, names: Sequence[str], parameters: BuildParameters
) -> Iterator[str]:
    """Yield a note on each drive of the request that is too old to be built, or in the base."""
    for name in parameters.drives or parameters.add or ():
        if name not in names:
            yield (
                f"drive {name} is left out, its upload began more than"
                f" {parameters.max_age_days:g} days ago"
            )
        elif base is not None and name in base.drives:
            yield (
                f"drive {name} is in the base already: its scans are read, and its poses placed,"
                " anew"
            )


def _notes_on_replaced(
    base: _Revision | None, drives: Sequence[FilledDrive], parameters: BuildParameters
) -> Iterator[str]:
    """Yield a note on each drive that is another recording than the base's of its name."""
    if base is None:
        return
    for drive in drives:
        # A base that was imported, or is of an early release, has no ids.
        built_id = base.record.drive_ids.get(drive.slug, drive.id)
        if built_id != drive.id and drive.slug not in (parameters.add or ()):
            yield (
                f"drive {drive.slug} is another recording than the base's of that name: its scans"
                " are read, and its frame is checked, as those of a new one"
            )


def _basis_kept_from(
    store: Store, map_id: str, base: _Revision | None, of_map: MapParameters
) -> str | None:
    """Return the digest of the base, or else of the live revision, whose basis is kept.

    `None` if it makes other signatures than maps of these parameters, or there is none.
    """
    try:
        kept = base or _live(store, map_id)
    except CorruptFile as error:
        raise unreadable_basis(error) from error
    if kept is None or not make_same_signatures(of_map, kept.parameters):
        return None
    return kept.record.digest


def _placed(
    base: _Revision, drives: Sequence[FilledDrive], parameters: BuildParameters
) -> dict[str, dict[str, Any]]:
    """Return where a plan has drives as its base has them, but those that are read anew."""
    anew, of_base = parameters.add or (), base.record.parameters
    kept = {drive.slug: drive.id for drive in drives if drive.slug not in anew}
    left = placements_without([*base.drives], base.placements, {*base.drives} - {*kept})
    placements = {name: left[name].as_attributes() for name in kept if name in left}
    poses = of_base.get("placed_poses", {})
    frames = of_base.get("confirmed_frames", {})  # early ones lack it
    if parameters.align == Align.AUTO and of_base.get("align") != Align.AUTO:
        frames = {}  # a check accepts what an alignment corrects
    same = [name for name in frames if base.record.drive_ids.get(name) == kept.get(name, "")]
    return {
        "placements": placements,
        "placed_poses": {name: poses[name] for name in poses if name in placements},
        "confirmed_frames": {name: frames[name] for name in same},
    }


def _mapped_scans(drive: FilledDrive) -> int:
    """Return the number of scans of a map that a drive's become."""
    return -(-drive.scans // drive.accumulate)  # the last one may have fewer of the drive's


def _require_serves(shared: Basis, of_map: MapParameters) -> None:
    """Raise `InvalidParameters` unless a shared basis is one for maps of these parameters."""
    if shared.serves(of_map):
        return
    wanted, given = _as_given(shared.parameters), _as_given(of_map)
    name = next(name for name in wanted if wanted[name] != given[name])
    if name == "radial_rank":  # which follows from the ranks
        name = "ranks"
        wanted, given = shared.parameters.as_attributes(), of_map.as_attributes()
    raise InvalidParameters(
        f"{name} is {given[name]}, that of the shared basis {shared.digest[:12]} is"
        f" {wanted[name]}: build with that, or without the basis"
    )


def _as_given(parameters: MapParameters) -> dict[str, Any]:
    """Return what signatures depend on, first what says on which other parameters they do."""
    first = {
        "encoding": parameters.encoding,
        "image": parameters.image.value,
        "views": parameters.views.value,
    }
    return first | signature_parameters(parameters)


def _with_views_of_basis(shared: Basis, parameters: BuildParameters) -> BuildParameters:
    """Return parameters whose default views are those of a shared basis of such images."""
    if parameters.views is not None:
        return parameters
    wanted, of_basis = _map_parameters_but_views(parameters), shared.parameters
    if (wanted.encoding, wanted.image) != (of_basis.encoding, of_basis.image):
        return parameters  # the basis is refused by these
    return parameters.model_copy(update={"views": of_basis.views})


def _with_views_of_live(store: Store, map_id: str, parameters: BuildParameters) -> BuildParameters:
    """Return parameters whose default views are those of the live revision of the same images.

    Its vehicles keep their basis, and drives whose returns were dropped have images of such views.
    """
    if parameters.views is not None:
        return parameters
    with suppress(CorruptFile):
        live = _live(store, map_id)
        wanted = _map_parameters_but_views(parameters)
        if live is not None and all(
            getattr(live.parameters, name) == getattr(wanted, name)
            for name in ("encoding", "image", "distance")
        ):
            taken: dict[str, object] = {"views": live.parameters.views}
            if parameters.verification_images is None:
                taken["verification_images"] = live.parameters.verification_images
            return parameters.model_copy(update=taken)
    return parameters


def _map_parameters_but_views(parameters: BuildParameters) -> MapParameters:
    """Return parameters of a map whose views are not chosen yet.

    Verification images are left out: where the views do not allow them they would be rejected.
    """
    return parameters.model_copy(update={"verification_images": None}).map_parameters()


def unreadable_basis(error: CorruptFile) -> CorruptFile:
    """Return the error of a build that would keep the basis of a damaged revision."""
    return CorruptFile(
        f"{error}: a build keeps the basis of the live revision, which cannot be read. Send"
        " refit: true to fit a new basis, which vehicles then download; or, to keep one,"
        " first make a revision live whose file can be read, imported or built before"
    )


def _base(store: Store, map_id: str, digest: str) -> _Revision:
    """Return the revision to base a build on, the live one for `live`."""
    if digest == "live":
        base = _live(store, map_id)
    else:
        base = _read(store, store.revisions.of_map(map_id, digest))
    if base is None:
        slug = store.maps.get_by_id(map_id).slug
        raise NoLiveRevision(f"map {slug!r} has no revision to base a build on: build without base")
    _require_stored_placements(base)
    return base


def _require_stored_placements(base: _Revision) -> None:
    """Reject a base whose file has other placements than the catalog.

    Nothing else of the file may be read by the build, and the text of attributes has no checksum.
    """
    placements = {name: placed.as_attributes() for name, placed in base.placements.items()}
    if base.record.parameters.get("placements", placements) != placements:  # early ones lack them
        raise CorruptFile(
            f"the file of revision {base.record.digest} has other placements of drives than it was"
            " stored with: build without base, or on another revision"
        )


def _live(store: Store, map_id: str) -> _Revision | None:
    digest = store.maps.get_by_id(map_id).live_revision
    return None if digest is None else _read(store, store.revisions.of_map(map_id, digest))


def _read(store: Store, record: RevisionRecord) -> _Revision:
    return _Revision(record, *store.revisions.read_parameters(record))


def _all_with_scans(store: Store, map_id: str) -> tuple[list[str], list[str]]:
    """Return the drives of a map that have scans, and a note on each other one."""
    drives = store.drives.of_map(map_id)
    notes = [
        f"drive {drive.slug} is left out, it has no scans"
        + (f", {_waiting(drive.expected_poses)}" if drive.expected_poses else "")
        + ": is its name mistyped?"
        for drive in drives
        if not drive.scans
    ]
    return [drive.slug for drive in drives if drive.scans], notes


def _waiting(poses: int) -> str:
    return "1 pose waits for one" if poses == 1 else f"{poses} poses wait for them"


def _changed(
    store: Store, map_id: str, base: _Revision, parameters: BuildParameters
) -> Sequence[str]:
    """Return the base's drives without those to remove, then those to add."""
    record, of_base = base.record, base.drives
    added, removed = parameters.add or [], parameters.remove or []
    unknown = [name for name in removed if name not in of_base]
    if unknown:
        raise UnknownDrive(
            f"base {record.digest[:12]} has no drive {unknown[0]!r}, it has {', '.join(of_base)}"
        )
    kept = [name for name in of_base if name not in {*added, *removed}]
    stored = {drive.slug: drive.id for drive in store.drives.of_map(map_id)}
    deleted = [name for name in kept if name not in stored]
    if deleted:
        why = _whereabouts(deleted[0], record, stored)
        raise DriveNotFound(f"drive {deleted[0]!r} of base {record.digest[:12]} is {why}")
    return [*kept, *added]


def _whereabouts(name: str, record: RevisionRecord, stored: Mapping[str, str]) -> str:
    """Return why a base's drive is not stored under its name, and what to do."""
    drive_id = record.drive_ids.get(name)
    if drive_id is None:
        return "not stored, the base was imported: upload it, or name it in remove"
    for other, other_id in stored.items():
        if other_id == drive_id:  # restored under another name
            return f"named {other!r} now: name that in add and {name!r} in remove"
    return (
        "no longer stored: restore it from the recycle bin, upload it again, or name it in remove"
    )


def _stored(
    store: Store, map_id: str, names: Sequence[str], max_age_days: float | None
) -> Sequence[FilledDrive]:
    """Return the drives of these names without those that are too old; each must have scans."""
    if not names:
        slug = store.maps.get_by_id(map_id).slug
        scans = any(drive.scans for drive in store.drives.of_map(map_id))
        reason = "no drive would be left" if scans else "upload scans first"
        raise EmptyDrive(f"map {slug!r} has no drive to build of: {reason}")
    drives: Sequence[FilledDrive] = store.drives.of_map(map_id, names)
    if max_age_days is not None:
        since = datetime.now(UTC) - timedelta(days=max_age_days)
        drives = [drive for drive in drives if drive.created_at >= since]
        if not drives:
            raise EmptyDrive(f"no drive of {len(names)} is younger than {max_age_days:g} days")
    empty = [drive.slug for drive in drives if not drive.scans]
    if empty:
        raise EmptyDrive(f"drive {empty[0]!r} has no scan")
    return drives
