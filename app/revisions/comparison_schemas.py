"""Comparisons of two revisions on the wire."""

from datetime import datetime
from typing import Any

import numpy as np
from pydantic import BaseModel, Field

from app.builds.recall import NoRecall, Recall
from app.http.shown import Shown
from core.evaluation.self_recall import CRITERION
from core.mapping.diff import drive_overlaps
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan
from storage.catalog import RevisionRecord

Side = tuple[RevisionRecord, TensorMap]


class ComparedOut(BaseModel):
    """A revision in numbers."""

    revision: str
    created_at: datetime
    size_bytes: int
    verification_bytes: int = Field(description="Bytes of these that are verification images.")
    drives: list[str]
    scans: int
    segments: int
    basis: str = Field(description="Digest of its basis, which signatures name.")
    relative_error_median: float = Field(
        description="Error of its segments' models, 0..1: the part of the images that signatures"
        " leave out."
    )
    relative_error_largest: float
    calibrated: bool
    threshold: float | None = Field(
        description="Below this probability an answer is a refusal; null if it is not calibrated."
    )
    nodes: int
    edges: int
    length_m: float | None = Field(
        description="Length of all edges of its graph; null where a pose on the way is unknown."
    )

    @classmethod
    def from_core(cls, record: RevisionRecord, tensor_map: TensorMap) -> "ComparedOut":
        """Return the model of one revision."""
        topology, calibration = tensor_map.topology, tensor_map.calibration
        return cls(
            revision=tensor_map.revision,
            created_at=record.created_at,
            size_bytes=record.size_bytes,
            verification_bytes=tensor_map.verification_bytes,
            drives=list(tensor_map.trajectory.drives),
            scans=len(tensor_map),
            segments=tensor_map.model.segments,
            basis=tensor_map.basis_digest,
            relative_error_median=float(np.median(tensor_map.relative_error)),
            relative_error_largest=float(tensor_map.relative_error.max()),
            calibrated=calibration is not None,
            threshold=calibration and calibration.threshold,
            nodes=len(topology.node_scan),
            edges=topology.edges,
            length_m=none_if_nan(topology.edge_length_m.sum()),
        )


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
    recall: RecallOut | None = Field(description="The recall; null if it is not known.")
    recall_unknown: NoRecall | None = Field(
        description="Why recall is not known: one was imported, or built before revisions stored"
        " their drives; no scan is in both; the images, from which queries are made, are not kept;"
        " no scan has another one near."
    )

    @classmethod
    def from_core(cls, this: Side, other: Side, recall: Recall | NoRecall) -> "ComparisonOut":
        """Return the model of two revisions and their recall."""
        (record, tensor_map), (other_record, other_map) = this, other
        mine, theirs = record.drive_ids, other_record.drive_ids
        anew = frozenset(name for name in mine.keys() & theirs.keys() if mine[name] != theirs[name])
        drives = drive_overlaps(tensor_map, other_map, recorded_anew=anew)
        own, compared = _parameters(*this), _parameters(*other)
        return cls(
            identical=tensor_map.revision == other_map.revision,
            this=ComparedOut.from_core(*this),
            other=ComparedOut.from_core(*other),
            same_basis=tensor_map.basis_digest == other_map.basis_digest,
            changed_parameters=[
                ChangedParameterOut(name=name, this=own.get(name), other=compared.get(name))
                for name in sorted({*own, *compared})
                if own.get(name) != compared.get(name)
            ],
            drives=[DriveOverlapOut.of(drive) for drive in drives],
            scans_in_both=sum(drive.in_both for drive in drives),
            scans_only_this=sum(drive.only_this for drive in drives),
            scans_only_other=sum(drive.only_other for drive in drives),
            recall=RecallOut.of(recall, asked=recall.queries, criterion=CRITERION)
            if isinstance(recall, Recall)
            else None,
            recall_unknown=recall if isinstance(recall, NoRecall) else None,
        )


def _parameters(record: RevisionRecord, tensor_map: TensorMap) -> dict[str, Any]:
    return {
        **tensor_map.parameters.as_attributes(),
        "segmentation": tensor_map.parameters.segmentation.value,
        "views": tensor_map.parameters.views.value,
        "segment_length": record.parameters.get("segment_length"),
    }
