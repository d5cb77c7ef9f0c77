"""What changed between two revisions of a map, in recall on its own scans too."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from app.drives.stored_images import images_path
from app.http.client import require_client
from core.arrays import FloatArray
from core.evaluation.self_recall import finds_own, is_findable
from core.mapping.diff import DriveOverlap, MapFacts, changed_parameters, drive_overlaps
from core.mapping.tensormap import TensorMap
from core.projection.images import ImageSource
from core.projection.probe import spread_evenly
from storage.catalog import RevisionRecord
from storage.errors import CorruptImages, DriveNotFound
from storage.files.image_file import ImageFile
from storage.store import Store, StoredDrive

MOST_ASKED = 200
"""How many scans are asked at most, evenly spread: some seconds on maps of thousands of scans."""
_ASKED_AT_ONCE = 10  # then it is seen whether anyone still waits for the answer


class NoRecall(StrEnum):
    """Why nothing can be said of recall."""

    NOT_BUILT_HERE = "not-built-here"
    NO_SCAN_IN_BOTH = "no-scan-in-both"
    IMAGES_NOT_KEPT = "images-not-kept"
    NOTHING_TO_FIND = "nothing-to-find"


@dataclass(frozen=True)
class Recall:
    """How many of the scans that both revisions have each of them finds.

    Attributes:
        asked: How many scans were asked.
        this: Share that the one finds, 0..1.
        other: Share that the other one finds.
        same_questions: Whether both were asked from the same places in the same headings. Maps with
            other renderings promise answers from other places, and are asked there.
    """

    asked: int
    this: float
    other: float
    same_questions: bool


@dataclass(frozen=True)
class Side:
    """One of the two.

    Attributes:
        record: What the catalog tells.
        facts: What its content tells.
    """

    record: RevisionRecord
    facts: MapFacts


@dataclass(frozen=True)
class Comparison:
    """What changed.

    Attributes:
        this: The one.
        other: The one it is compared with.
        parameters: What was chosen otherwise, `(this, other)` by name.
        drives: How many scans of each drive both have.
        recall: How well both find the scans that they share, or why that is not known.
    """

    this: Side
    other: Side
    parameters: dict[str, tuple[Any, Any]]
    drives: tuple[DriveOverlap, ...]
    recall: Recall | NoRecall


@dataclass(frozen=True, eq=False)
class _Question:
    """A scan of a map, and where its probe is."""

    row: int
    images: ImageSource
    position: int
    standing: FloatArray


def compare_revisions(
    store: Store, this: tuple[RevisionRecord, TensorMap], other: tuple[RevisionRecord, TensorMap]
) -> Comparison:
    """Compare two revisions of one map. It depends on nothing but them and the images kept.

    Raises:
        MapNotFound: If the map is gone.
    """
    (record, tensor_map), (other_record, other_map) = this, other
    mine, theirs = record.drive_ids, other_record.drive_ids
    anew = frozenset(name for name in mine.keys() & theirs.keys() if mine[name] != theirs[name])
    return Comparison(
        Side(record, MapFacts.of(tensor_map)),
        Side(other_record, MapFacts.of(other_map)),
        changed_parameters(_chosen(*this), _chosen(*other)),
        drive_overlaps(tensor_map, other_map, recorded_anew=anew),
        measure_recall(store, record.map_id, (mine, tensor_map), (theirs, other_map)),
    )


def _chosen(record: RevisionRecord, tensor_map: TensorMap) -> dict[str, Any]:
    chosen = tensor_map.parameters.as_attributes()
    chosen["segmentation"] = tensor_map.parameters.segmentation.value
    chosen["segment_length"] = record.parameters.get("segment_length")
    return chosen


def measure_recall(
    store: Store,
    map_id: str,
    this: tuple[Mapping[str, str], TensorMap],
    other: tuple[Mapping[str, str], TensorMap],
) -> Recall | NoRecall:
    """Return how many of their common scans two revisions find; one need not be published yet.

    Args:
        store: With the images of their drives.
        map_id: Of the map.
        this: Ids of its drives by slug, and the one.
        other: The same of the other.

    Raises:
        MapNotFound: If the map is gone.
    """
    (drive_ids, tensor_map), (other_ids, other_map) = this, other
    if not (drive_ids and other_ids):
        return NoRecall.NOT_BUILT_HERE
    shared = [n for n, i in drive_ids.items() if other_ids.get(n) == i]
    if not any(
        drive.in_both for drive in drive_overlaps(tensor_map, other_map) if drive.drive in shared
    ):
        return NoRecall.NO_SCAN_IN_BOTH
    pairs: list[tuple[_Question, _Question]] = []
    with ExitStack() as stack:
        for name in shared:
            try:
                (drive,) = store.drives.open_of_map(map_id, [name])
            except DriveNotFound:
                continue
            if drive.id == drive_ids[name]:
                mine = _questions(store, drive, tensor_map, stack)
                theirs = _questions(store, drive, other_map, stack)
                pairs += [
                    (mine[scan], theirs[scan]) for scan in sorted(mine.keys() & theirs.keys())
                ]
        if not pairs:
            return NoRecall.IMAGES_NOT_KEPT
        asked = [
            (mine, theirs)
            for mine, theirs in (pairs[i] for i in spread_evenly(np.arange(len(pairs)), MOST_ASKED))
            if is_findable(tensor_map, mine.row) and is_findable(other_map, theirs.row)
        ]
        if not asked:
            return NoRecall.NOTHING_TO_FIND
        return Recall(
            len(asked),
            _found(tensor_map, [mine for mine, _ in asked]),
            _found(other_map, [theirs for _, theirs in asked]),
            all(np.array_equal(mine.standing, theirs.standing) for mine, theirs in asked),
        )


def _found(tensor_map: TensorMap, questions: list[_Question]) -> float:
    found = []
    for at in range(0, len(questions), _ASKED_AT_ONCE):
        require_client()
        asked = questions[at : at + _ASKED_AT_ONCE]
        probes = [(question.images, question.position) for question in asked]
        found.append(finds_own(tensor_map, [question.row for question in asked], probes))
    return float(np.concatenate(found).mean())


def _questions(
    store: Store, drive: StoredDrive, tensor_map: TensorMap, stack: ExitStack
) -> dict[int, _Question]:
    """Return the probes of a drive's scans that a map has, by index; none if they are not kept."""
    path = images_path(store, drive, tensor_map.parameters)
    if not path.exists():
        return {}
    try:
        images = stack.enter_context(ImageFile(path, tensor_map.parameters.imager))
    except CorruptImages:
        return {}
    if images.probes is None:
        return {}
    trajectory = tensor_map.trajectory
    of_drive = np.flatnonzero(trajectory.drive_of_scan == trajectory.drives.index(drive.name))
    row_of = dict(zip(trajectory.scan_index[of_drive].tolist(), of_drive.tolist(), strict=True))
    indices = drive.scan_index[images.probed].tolist()
    return {
        index: _Question(row_of[index], images.probes, position, images.standing[position])
        for position, index in enumerate(indices)
        if index in row_of
    }
