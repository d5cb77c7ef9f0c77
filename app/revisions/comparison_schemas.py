"""What changed between two revisions, over the wire."""

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field

from app.http.shown import Shown
from app.revisions.comparison import Comparison, NoRecall, Recall, Side
from core.evaluation.self_recall import CRITERION


class ComparedOut(Shown):
    """A revision in numbers."""

    revision: str
    created_at: datetime
    size_bytes: int
    drives: list[str]
    scans: int
    segments: int
    basis: str = Field(description="Digest of its basis: what signatures name.")
    relative_error_median: float = Field(
        description="Of its segments, 0..1: what signatures leave out of the images."
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
    def from_core(cls, side: Side) -> "ComparedOut":
        """Show one of the two."""
        record = side.record
        return cls.of(side.facts, created_at=record.created_at, size_bytes=record.size_bytes)


class ChangedParameterOut(BaseModel):
    """A parameter that the two have otherwise; null where one has none."""

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
    """How many of their common scans the two find, asked as a vehicle that stands elsewhere."""

    asked: int = Field(description="How many scans were asked, evenly spread, at most 200.")
    this: float = Field(description="Share that this revision finds with its first match, 0..1.")
    other: float
    same_questions: bool = Field(
        description="Whether both were asked from the same places in the same headings. Maps with"
        " other renderings, or of the other encoding, promise answers from other places."
    )
    criterion: str = Field(description="What counts as found.")


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
    recall: RecallOut | None = Field(description="Null where it cannot be known.")
    recall_unknown: NoRecall | None = Field(
        description="Why it cannot be: one was imported, or built before its drives were written"
        " down; no scan is in both; the images, from which questions are made, are not kept; no"
        " scan has another one near."
    )

    @classmethod
    def from_core(cls, comparison: Comparison) -> "ComparisonOut":
        """Show what changed."""
        recall, drives = comparison.recall, comparison.drives
        this, other = comparison.this.facts, comparison.other.facts
        return cls(
            identical=this.revision == other.revision,
            this=ComparedOut.from_core(comparison.this),
            other=ComparedOut.from_core(comparison.other),
            same_basis=this.basis == other.basis,
            changed_parameters=[
                ChangedParameterOut(name=name, this=mine, other=theirs)
                for name, (mine, theirs) in comparison.parameters.items()
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
