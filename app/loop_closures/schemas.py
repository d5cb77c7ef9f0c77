"""Proposed loop closures on the wire."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator

from app.http.exact_types import Name, Number, integers
from app.http.shown import Shown
from app.localization.signature_schemas import SignaturesIn
from core.loop_closure.closure import ACCEPT_FROM, ClosureDecision, LoopClosure
from core.scans.trajectory import SCAN_INDEX_LIMIT

_MOST = 100  # proposals; a pair of scans takes about a tenth of a second


class StoredScanIn(BaseModel):
    """A scan of one of the map's drives."""

    model_config = ConfigDict(extra="forbid")

    drive: Name = Field(max_length=64)
    scan_index: int = Field(ge=0, lt=SCAN_INDEX_LIMIT)

    _integers = field_validator("scan_index", mode="before")(integers)


def _form_of(item: Any) -> str:  # noqa: ANN401 - whatever a client sends
    if isinstance(item, dict):
        return "signatures" if "signatures" in item else "scan"
    return "signatures" if isinstance(item, SignaturesIn) else "scan"


ScanIn = Annotated[
    Annotated[StoredScanIn, Tag("scan")] | Annotated[SignaturesIn, Tag("signatures")],
    Discriminator(_form_of),
]


class ProposalIn(BaseModel):
    """Two scans that may show one place."""

    model_config = ConfigDict(extra="forbid")

    first: StoredScanIn = Field(description="What the answer is relative to.")
    second: ScanIn = Field(
        description="Another stored scan, compared by the returns of both; or signatures of one"
        " that is not stored, compared with the first one's in the revision that they name."
    )


class LoopClosuresIn(BaseModel):
    """Proposed closures, checked one by one."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "proposals": [
                    {
                        "first": {"drive": "monday", "scan_index": 3},
                        "second": {"drive": "monday", "scan_index": 47},
                    }
                ]
            }
        },
    )

    proposals: list[ProposalIn] = Field(min_length=1, max_length=_MOST, fail_fast=True)
    accept_from: Number = Field(
        ACCEPT_FROM,
        gt=0.5,
        le=1,
        description="Lowest probability to accept; below 0.5 it is rejected.",
    )
    sensor_height_m: Number | None = Field(
        None,
        gt=0,
        lt=100,
        description="Height of the drives' sensor above ground, where they have no mounting; that"
        " of the live revision by default.",
    )


class LoopClosureOut(Shown):
    """The result of one proposal."""

    verdict: ClosureDecision
    probability: float | None = Field(
        description="Probability that the scans are within some 5 m of each other, with even prior"
        " odds; null if signatures are compared with a map without calibration."
    )
    turn_deg: float | None = Field(
        description="Relative yaw of the second, counter-clockwise, -180..180."
    )
    forward_m: float | None = Field(description="Distance of the second ahead of the first.")
    lateral_m: float | None = Field(description="Distance of the second to the left of the first.")
    image_similarity: float | None = Field(
        description="Similarity of the height images in the best heading, at most 1; null without"
        " returns."
    )
    overlap: float | None = Field(
        description="Similarity of the bird's-eye views in the best alignment, at most 1; null"
        " without returns."
    )
    signature_distance: float | None = Field(
        description="Distance in the map's measure; null where returns were compared."
    )

    @classmethod
    def from_core(cls, found: LoopClosure, accept_from: float) -> "LoopClosureOut":
        """Return the model of a checked closure."""
        return cls.of(found, verdict=found.decide(accept_from), turn_deg=found.relative_yaw_deg)


class LoopClosuresOut(BaseModel):
    """The results of the proposals, in their order."""

    closures: list[LoopClosureOut]
