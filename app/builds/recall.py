"""Recall of maps on their own scans, and of two on those that both have."""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from app.drives.mapped_drives import mapped_drive
from app.drives.stored_images import images_path
from app.http.client import require_client
from core.arrays import FloatArray
from core.evaluation.self_recall import finds_own, is_findable
from core.mapping.diff import drive_overlaps
from core.mapping.tensormap import TensorMap
from core.projection.images import ImageSource
from core.scans.drive import scan_index_of
from core.scans.sampling import spread_evenly
from storage.errors import CorruptImages, DriveNotFound
from storage.files.image_file import ImageFile
from storage.store import Store, StoredDrive

_log = logging.getLogger("tensormap.builds")

MOST_QUERIES = 200
"""Most queries, evenly spread: some seconds on maps of thousands of scans."""
_QUERIES_AT_ONCE = 10  # between two checks whether the client is still connected


class DrivenMap(NamedTuple):
    """A map, and the ids by slug of its drives that are stored; none of one that was imported."""

    drive_ids: Mapping[str, str]
    tensor_map: TensorMap


class NoRecall(StrEnum):
    """Why recall is not known."""

    NOT_BUILT_HERE = "not-built-here"
    NO_SCAN_IN_BOTH = "no-scan-in-both"
    IMAGES_NOT_KEPT = "images-not-kept"
    NOTHING_TO_FIND = "nothing-to-find"


@dataclass(frozen=True)
class Recall:
    """Self-recall of two maps on their common scans.

    Attributes:
        queries: How many scans were queries.
        this: Share that the first map finds, 0..1.
        other: Share that the second one finds.
        same_questions: Whether both had queries from the same places in the same headings. Maps
            with other renderings answer other places, and are queried there.
    """

    queries: int
    this: float
    other: float
    same_questions: bool


@dataclass(frozen=True)
class OwnRecall:
    """Self-recall of one map on scans of its drives.

    Attributes:
        queries: How many scans were queries.
        share: Share that it finds, 0..1.
    """

    queries: int
    share: float


@dataclass(frozen=True, eq=False)
class _Query:
    """A scan of a map, and its probe."""

    row: int
    images: ImageSource
    position: int
    displacement: FloatArray


def measure_recall(
    store: Store,
    map_id: str,
    this: DrivenMap,
    other: DrivenMap,
) -> Recall | NoRecall:
    """Return the recall of two maps on their common scans; one need not be published yet.

    Args:
        store: The store with the images of their drives.
        map_id: The map's id.
        this: The first map.
        other: The second map.

    Raises:
        MapNotFound: If the map is gone.
    """
    (drive_ids, tensor_map), (other_ids, other_map) = this, other
    if not (drive_ids and other_ids):
        return NoRecall.NOT_BUILT_HERE
    shared = [name for name, drive_id in drive_ids.items() if other_ids.get(name) == drive_id]
    overlaps = drive_overlaps(tensor_map, other_map)
    if not any(drive.in_both for drive in overlaps if drive.drive in shared):
        return NoRecall.NO_SCAN_IN_BOTH
    pairs: list[tuple[_Query, _Query]] = []
    with ExitStack() as stack:
        for name, drive in _stored(store, map_id, {name: drive_ids[name] for name in shared}):
            mine = _queries(store, name, drive, tensor_map, stack)
            theirs = _queries(store, name, drive, other_map, stack)
            pairs += [(mine[scan], theirs[scan]) for scan in sorted(mine.keys() & theirs)]
        found = _measured([tensor_map, other_map], pairs)
    if isinstance(found, NoRecall):
        return found
    (of_this, asked), (of_other, asked_other) = found
    same = all(
        np.array_equal(one.displacement, another.displacement)
        for one, another in zip(asked, asked_other, strict=True)
    )
    return Recall(len(asked), of_this, of_other, same)


def measure_own_recall(
    store: Store, map_id: str, side: DrivenMap, names: Iterable[str]
) -> OwnRecall | NoRecall:
    """Return the recall of a map on the scans of some of its drives.

    Args:
        store: The store with the images of its drives.
        map_id: The map's id.
        side: The map.
        names: The drives' names.

    Raises:
        MapNotFound: If the map is gone.
    """
    drive_ids, tensor_map = side
    if not drive_ids:
        return NoRecall.NOT_BUILT_HERE
    with ExitStack() as stack:
        queries = [
            (query,)
            for name, drive in _stored(store, map_id, {name: drive_ids[name] for name in names})
            for query in _queries(store, name, drive, tensor_map, stack).values()
        ]
        found = _measured([tensor_map], queries)
    if isinstance(found, NoRecall):
        return found
    [(share, findable)] = found
    return OwnRecall(len(findable), share)


def _measured(
    maps: Sequence[TensorMap], scans: Sequence[tuple[_Query, ...]]
) -> list[tuple[float, Sequence[_Query]]] | NoRecall:
    """Return the share that each map finds of some scans, and its queries; or why it is unknown.

    Args:
        maps: The maps.
        scans: Each one's queries, one of each map. Of them `MOST_QUERIES` are chosen, and of these
            the ones that every map can find.
    """
    if not scans:
        return NoRecall.IMAGES_NOT_KEPT
    chosen = [scans[i] for i in spread_evenly(np.arange(len(scans)), MOST_QUERIES)]
    findable = [
        queries
        for queries in chosen
        if all(is_findable(one, query.row) for one, query in zip(maps, queries, strict=True))
    ]
    if not findable:
        return NoRecall.NOTHING_TO_FIND
    of_maps = list(zip(*findable, strict=True))
    try:
        return [
            (_share_found(one, queries), queries)
            for one, queries in zip(maps, of_maps, strict=True)
        ]
    except CorruptImages as error:  # a build that needs them makes them anew, others do not
        _log.warning("recall is not measured: %s", error)
        return NoRecall.IMAGES_NOT_KEPT


def drives_stored_here(store: Store, map_id: str, tensor_map: TensorMap) -> dict[str, str]:
    """Return the ids of the stored drives that a map from a file was built of, by slug.

    They have the same name, scans of the same indices and times and, where times are unknown, the
    same poses.

    Raises:
        MapNotFound: If the map is gone.
    """
    trajectory = tensor_map.trajectory
    found: dict[str, str] = {}
    of_its_names = {
        drive.slug: drive.id
        for drive in store.drives.of_map(map_id)
        if drive.slug in trajectory.drives and drive.scans
    }
    for _, drive in _stored(store, map_id, of_its_names):
        mapped = mapped_drive(drive, tensor_map.parameters.sensor_height_m)
        rows = trajectory.rows_of(drive.name)
        index, wanted = scan_index_of(mapped), trajectory.scan_index[rows]
        at = np.minimum(np.searchsorted(index, wanted), len(index) - 1)
        timestamp_s = trajectory.timestamp_s[rows]
        if (
            np.array_equal(index[at], wanted)
            and np.array_equal(mapped.timestamp_s[at], timestamp_s, equal_nan=True)
            and (
                np.isfinite(timestamp_s).all()
                or np.array_equal(mapped.poses[at], trajectory.poses[rows], equal_nan=True)
            )
        ):
            found[drive.name] = drive.id
    return found


def _stored(
    store: Store, map_id: str, drive_ids: Mapping[str, str]
) -> Iterator[tuple[str, StoredDrive]]:
    """Yield those of these drives that are still stored, by the names that they had."""
    now = {drive.id: drive.slug for drive in store.drives.of_map(map_id)}
    for name, drive_id in drive_ids.items():
        if drive_id not in now:
            continue
        try:
            (drive,) = store.drives.open_of_map(map_id, [now[drive_id]])
        except DriveNotFound:  # deleted meanwhile
            continue
        if drive.id == drive_id:
            yield name, drive


def _share_found(tensor_map: TensorMap, queries: Sequence[_Query]) -> float:
    found = []
    for at in range(0, len(queries), _QUERIES_AT_ONCE):
        require_client()
        batch = queries[at : at + _QUERIES_AT_ONCE]
        probes = [(query.images, query.position) for query in batch]
        found.append(finds_own(tensor_map, [query.row for query in batch], probes))
    return float(np.concatenate(found).mean())


def _queries(
    store: Store, name: str, drive: StoredDrive, tensor_map: TensorMap, stack: ExitStack
) -> dict[int, _Query]:
    """Return the probes of a drive's scans that a map has, by index; none if they are not kept.

    Args:
        store: The store with its images.
        name: The drive's name in the map.
        drive: The drive.
        tensor_map: The map.
        stack: Closes its images.
    """
    path = images_path(store, drive, tensor_map.parameters)
    if not path.exists():
        return {}
    try:
        images = stack.enter_context(ImageFile(path, tensor_map.parameters.imager))
    except CorruptImages:
        return {}
    if images.probes is None:
        return {}
    found: dict[int, _Query] = {}
    mapped = mapped_drive(drive, tensor_map.parameters.sensor_height_m)
    for position, index in enumerate(scan_index_of(mapped)[images.probed].tolist()):
        row = tensor_map.trajectory.row_of(name, index)
        if row is not None:
            found[index] = _Query(row, images.probes, position, images.displacement[position])
    return found
