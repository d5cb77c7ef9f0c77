"""Comparisons of two revisions on the wire."""

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from app.http.shown import Shown
from app.revisions.recall import NoRecall, Recall
from core.evaluation.self_recall import CRITERION
from core.mapping.diff import MapFacts, changed_parameters, drive_overlaps
from core.mapping.tensormap import TensorMap
from storage.catalog import RevisionRecord

Side = tuple[RevisionRecord, TensorMap]


class ComparedOut(Shown):
    """A revision in numbers."""

    revision: str
    created_at: datetime
    size_bytes: int
    drives: list[str]
    scans: int
    segments: int
    basis: str = Field(description="Digest of its basis, which signatures name.")
    relative_error_median: float = Field(
        description="Of its segments, 0..1: the part of the images that signatures leave out."
    )
    relative_error_largest: float
    calibrated: bool
    threshold: float | None = Field(
        description="Below this probability an answer is a refusal; null if it is not calibrated."
    )
    nodes: int
    edges: int
    length_m: float | None = Field(
        description="Of all edges of its graph; null where a pose on the way is unknown."
    )

    @classmethod
    def from_core(cls, record: RevisionRecord, facts: MapFacts) -> "ComparedOut":
        """Return the model of one revision."""
        return cls.of(facts, created_at=record.created_at, size_bytes=record.size_bytes)


class ChangedParameterOut(BaseModel):
    """A parameter with different values; null where one has none."""

    name: str
    this: Any
    other: Any


class DriveOverlapOut(Shown):
    """How many scans of a drive the two have."""

    drive: str
    in_both: int
    only_this: int
    only_other: int


class RecallOut(Shown):
    """Self-recall of the two on their common scans, seen from beside."""

    asked: int = Field(description="How many scans were queries, evenly spread, at most 200.")
    this: float = Field(description="Share that this revision finds with its first match, 0..1.")
    other: float
    same_questions: bool = Field(
        description="Whether both had queries from the same places in the same headings. Maps with"
        " other renderings, or of the other encoding, answer other places."
    )
    criterion: str = Field(description="When a match counts as found.")


class ComparisonOut(BaseModel):
    """What changed between two revisions of a map."""

    identical: bool = Field(description="Whether they are one revision.")
    this: ComparedOut
    other: ComparedOut
    same_basis: bool = Field(description="Whether signatures of one are answered by the other.")
    changed_parameters: list[ChangedParameterOut]
    drives: list[DriveOverlapOut]
    scans_in_both: int
    scans_only_this: int
    scans_only_other: int
    recall: RecallOut | None = Field(description="Null if it is not known.")
    recall_unknown: NoRecall | None = Field(
        description="Why not: one was imported, or built before revisions stored their drives; no"
        " scan is in both; the images, from which queries are made, are not kept; no scan has"
        " another one near."
    )

    @classmethod
    def from_core(cls, this: Side, other: Side, recall: Recall | NoRecall) -> "ComparisonOut":
        """Return the model of two revisions and their recall."""
        (record, tensor_map), (other_record, other_map) = this, other
        facts, other_facts = MapFacts.of(tensor_map), MapFacts.of(other_map)
        mine, theirs = record.drive_ids, other_record.drive_ids
        anew = frozenset(name for name in mine.keys() & theirs.keys() if mine[name] != theirs[name])
        drives = drive_overlaps(tensor_map, other_map, recorded_anew=anew)
        changed = changed_parameters(_parameters(*this), _parameters(*other))
        return cls(
            identical=facts.revision == other_facts.revision,
            this=ComparedOut.from_core(record, facts),
            other=ComparedOut.from_core(other_record, other_facts),
            same_basis=facts.basis == other_facts.basis,
            changed_parameters=[
                ChangedParameterOut(name=name, this=one, other=two)
                for name, (one, two) in changed.items()
            ],
            drives=[DriveOverlapOut.of(drive) for drive in drives],
            scans_in_both=sum(drive.in_both for drive in drives),
            scans_only_this=sum(drive.only_this for drive in drives),
            scans_only_other=sum(drive.only_other for drive in drives),
            recall=RecallOut.of(recall, criterion=CRITERION)
            if isinstance(recall, Recall)
            else None,
            recall_unknown=recall if isinstance(recall, NoRecall) else None,
        )


def _parameters(record: RevisionRecord, tensor_map: TensorMap) -> dict[str, Any]:
    return {
        **tensor_map.parameters.as_attributes(),
        "segmentation": tensor_map.parameters.segmentation.value,
        "segment_length": record.parameters.get("segment_length"),
    }
