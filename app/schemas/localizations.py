"""Queries and answers over the wire."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from fastapi import Query
from pydantic import BaseModel, ConfigDict, Field

from app.schemas.poses import PoseOut
from core.errors import InvalidSignature
from core.localizer import Localization, Match
from core.signature import Signature

__all__ = ["LocalizationOut", "NearestCount", "SignaturesIn"]

NearestCount = Annotated[
    int, Query(alias="k", ge=1, le=1000, description="How many nearest scans to answer.")
]


# Bounds as in the packed form; of a list that is wrong, its first fault is told.
_Row = Annotated[list[float], Field(max_length=255, fail_fast=True)]


class SegmentSignatureIn(BaseModel):
    """A signature and the segment whose bases made it."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    segment: int = Field(ge=0, le=0xFFFF)
    values: list[_Row] = Field(
        min_length=1, max_length=255, fail_fast=True, description="r1 rows of r2 numbers."
    )


class SignaturesIn(BaseModel):
    """One scan's signatures, made with one revision's bases."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "revision": "0f" * 32,
                "signatures": [{"segment": 3, "values": [[950.1, -3.2], [12.5, 60.8]]}],
            }
        },
    )

    revision: str = Field(
        pattern="^[0-9a-f]{16,64}$", description="Its digest, or at least 16 first digits."
    )
    signatures: list[SegmentSignatureIn] = Field(min_length=1, max_length=0x10000, fail_fast=True)

    @classmethod
    def from_core(cls, signatures: Sequence[Signature]) -> "SignaturesIn":
        """Show signatures of one revision as they are sent."""
        return cls(
            revision=signatures[0].revision,
            signatures=[
                SegmentSignatureIn(segment=s.segment, values=s.values.tolist()) for s in signatures
            ],
        )

    def to_core(self) -> tuple[Signature, ...]:
        """Return the signatures.

        Raises:
            InvalidSignature: If one's rows differ in length or a number is beyond float32.
        """
        signatures = []
        for item in self.signatures:
            if len({len(row) for row in item.values}) > 1:
                raise InvalidSignature(f"the rows of segment {item.segment} differ in length")
            with np.errstate(over="ignore"):  # infinite then, and refused as such
                values = np.array(item.values, dtype=np.float64).astype(np.float32)
            signatures.append(Signature(values, item.segment, self.revision))
        return tuple(signatures)


class MatchOut(BaseModel):
    """A scan of the map, and how far the query is from it."""

    segment: int
    fraction: float = Field(description="How far along the segment: 0 at one node, 1 at the other.")
    along_m: float | None = Field(description="The same in metres; null without poses.")
    drive: str
    scan_index: int = Field(description="Its index in that drive.")
    distance: float = Field(description="Frobenius distance of the signatures.")
    timestamp_s: float | None
    pose: PoseOut | None

    @classmethod
    def from_core(cls, match: Match) -> "MatchOut":
        """Show a match."""
        return cls(
            segment=match.segment,
            fraction=match.fraction,
            along_m=match.along_m,
            drive=match.drive,
            scan_index=match.scan_index,
            distance=match.distance,
            timestamp_s=match.timestamp_s,
            pose=None if match.pose is None else PoseOut.from_core(match.pose),
        )


class LocalizationOut(BaseModel):
    """Where the query was taken, as far as the map can tell.

    The paper's encoding always names its nearest scan, for a query from elsewhere too: a `ratio`
    near 1 says that another place is as near.
    """

    revision: str = Field(description="The revision that answered.")
    live_revision: str = Field(description="The revision that is live now.")
    best: MatchOut
    matches: list[MatchOut] = Field(description="The k nearest scans, nearest first.")
    runner_up: MatchOut | None = Field(description="The nearest scan away from the best one.")
    ratio: float | None = Field(description="Distance of the best over that of the runner-up.")
    segments_searched: list[int]

    @classmethod
    def from_core(cls, found: Localization, live_revision: str) -> "LocalizationOut":
        """Show an answer."""
        return cls(
            revision=found.revision,
            live_revision=live_revision,
            best=MatchOut.from_core(found.best),
            matches=[MatchOut.from_core(match) for match in found.matches],
            runner_up=None if found.runner_up is None else MatchOut.from_core(found.runner_up),
            ratio=found.ratio,
            segments_searched=list(found.segments),
        )
