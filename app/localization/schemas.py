"""Queries and answers over the wire."""

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import Query
from pydantic import (
    AfterValidator,
    AliasChoices,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)
from pydantic.json_schema import SkipJsonSchema

from app.drives.pose_schemas import PoseOut
from app.http.exact_types import Number, integers
from core.confidence.verdict import Refusal
from core.encodings.registry import encoding_named, encoding_names
from core.encodings.signature import Signature
from core.localization.localizer import Localization
from core.localization.match import Match

_OTHER = "other"
SIGNATURE_TAGS = {"paper", "harmonic", _OTHER}
"""Forms of a signature; pydantic's errors name them between an item and its fields."""

NearestCount = Annotated[
    int, Query(alias="k", ge=1, le=1000, description="How many nearest scans to answer.")
]


# Bounds as in the packed form; of a list that is wrong, its first fault is told.
_Row = Annotated[list[Number], Field(max_length=255, fail_fast=True)]


class SegmentSignatureIn(BaseModel):
    """A signature and the segment whose bases made it."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    segment: int = Field(ge=0, le=0xFFFF)
    values: list[_Row] = Field(
        min_length=1, max_length=255, fail_fast=True, description="r1 rows of r2 numbers."
    )

    _integers = field_validator("segment", mode="before")(integers)


class HarmonicSignatureIn(BaseModel):
    """A signature made with a harmonic map's basis, good for all its segments."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    values_real: list[_Row] = Field(
        min_length=1,
        max_length=255,
        fail_fast=True,
        description="Real parts, r1 rows of r2 numbers.",
    )
    values_imag: list[_Row] = Field(
        min_length=1,
        max_length=255,
        fail_fast=True,
        description="Imaginary parts, of the same shape; the first column is 0.",
    )


def _of_registered(item: dict[str, Any]) -> dict[str, Any]:
    name = item["encoding"]
    if not isinstance(name, str) or name in SIGNATURE_TAGS or name not in encoding_names():
        raise ValueError("no encoding of that name is registered besides ours")
    return item


# Of an encoding that was registered besides ours: it reads the rest by itself.
_RegisteredSignatureIn = Annotated[dict[str, Any], AfterValidator(_of_registered)]


def _form_of(item: Any) -> str:  # noqa: ANN401 - whatever a client sends
    given = item if isinstance(item, dict) else getattr(item, "model_fields_set", ())
    if {"values_real", "values_imag"} & set(given):
        return "harmonic"
    return _OTHER if "encoding" in given else "paper"


SignatureIn = Annotated[
    Annotated[SegmentSignatureIn, Tag("paper")]
    | Annotated[HarmonicSignatureIn, Tag("harmonic")]
    | Annotated[SkipJsonSchema[_RegisteredSignatureIn], Tag(_OTHER)],
    Discriminator(_form_of),
]


class SignaturesIn(BaseModel):
    """One scan's signatures, made with one basis; a harmonic map's is one.

    They name that basis, or a revision that has it.
    """

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "basis": "0f" * 32,
                "signatures": [{"segment": 3, "values": [[950.1, -3.2], [12.5, 60.8]]}],
            },
            "examples": [
                {
                    "basis": "0f" * 32,
                    "signatures": [
                        {
                            "values_real": [[85.2, -3.1], [10.4, 6.2]],
                            "values_imag": [[0.0, 7.5], [0.0, -1.9]],
                        }
                    ],
                },
            ],
        },
    )

    basis: Annotated[str, Field(pattern="^[0-9a-f]{16,64}$")] | None = Field(
        None,
        description="Digest of the basis that made them, or at least 16 first digits: any revision"
        " that has it answers, the live one first.",
    )
    revision: Annotated[str, Field(pattern="^[0-9a-f]{16,64}$")] | None = Field(
        None, description="Instead: digest of the revision that is to answer."
    )
    signatures: list[SignatureIn] = Field(min_length=1, max_length=0x10000, fail_fast=True)

    @model_validator(mode="after")
    def _one_name(self) -> "SignaturesIn":
        if (self.basis is None) == (self.revision is None):
            raise ValueError("give the basis that made the signatures, or else a revision")
        return self

    @property
    def named(self) -> str:
        """What they name."""
        return self.basis or self.revision or ""

    @classmethod
    def from_core(cls, signatures: Sequence[Signature]) -> "SignaturesIn":
        """Show signatures of one basis as they are sent."""
        return cls(
            basis=signatures[0].revision,
            signatures=[
                encoding_named(signature.encoding).as_values(signature) for signature in signatures
            ],
        )

    def to_core(self) -> tuple[Signature, ...]:
        """Return the signatures.

        Raises:
            InvalidSignature: If one's rows differ in length or a number is beyond float32.
        """
        signatures = []
        for item in self.signatures:
            values = dict(item) if isinstance(item, dict) else item.model_dump()
            encoding = encoding_named(values.pop("encoding", _form_of(item)))
            signatures.append(encoding.from_values(values, self.named))
        return tuple(signatures)


class MatchOut(BaseModel):
    """A scan of the map, and how far the query is from it."""

    model_config = ConfigDict(from_attributes=True)

    segment: int
    fraction: float = Field(description="How far along the segment: 0 at one node, 1 at the other.")
    along_m: float | None = Field(description="The same in metres; null without poses.")
    drive: str
    scan_index: int = Field(description="Its index in that drive.")
    distance: float = Field(
        description="Of the signatures: Frobenius; in a harmonic map the one it was built with."
    )
    timestamp_s: float | None
    pose: PoseOut | None
    turn_deg: float | None = Field(
        validation_alias=AliasChoices("turn_deg", "relative_yaw_deg"),
        description="How far the query is turned from that scan, counter-clockwise, -180..180; null"
        " in the paper's encoding.",
    )
    lateral_m: float | None = Field(
        description="How far to the left of that scan the query stands; null likewise."
    )
    heading_deg: float | None = Field(
        description="Estimated heading of the query in the world; null likewise or without poses."
    )
    estimated_pose: PoseOut | None = Field(
        description="Where the query stands: that scan's pose, displaced and turned; null likewise."
    )

    @classmethod
    def from_core(cls, match: Match) -> "MatchOut":
        """Show a match."""
        return cls.model_validate(match)


class CovarianceOut(BaseModel):
    """Of the position, in the map's frame."""

    xx_m2: float
    xy_m2: float
    yy_m2: float


class LocalizationOut(BaseModel):
    """Where the query was taken, as far as the map can tell.

    It names its nearest scan for a query from elsewhere too, to be looked at: only with
    `localized` true is it an answer.
    """

    revision: str = Field(description="The revision that answered.")
    live_revision: str = Field(description="The revision that is live now.")
    localized: bool = Field(description="Whether the best match may be taken for the place.")
    reason: Refusal | None = Field(
        description="Why not. `unknown_place`: nothing is near enough; `ambiguous`: it is, but"
        " another place nearly as much; `too_few_returns`: the image is too empty;"
        " `outside_prior`: nothing fits the hints, or elsewhere fits far better;"
        " `not_calibrated`: `min_probability` was asked of a map that cannot tell."
    )
    probability: float | None = Field(
        description="That the best match is right, if a query is as likely in the map as"
        " elsewhere; null from a map that was not calibrated: it refuses nothing."
    )
    along_std_m: float | None = Field(
        description="If it is right: standard deviation of the position along the path; null"
        " without calibration or poses."
    )
    lateral_std_m: float | None = Field(description="The same across the path.")
    heading_std_deg: float | None = Field(
        description="The same of the heading; null in the paper's encoding."
    )
    position_covariance: CovarianceOut | None = Field(
        description="The two of them in the map's frame."
    )
    best: MatchOut
    matches: list[MatchOut] = Field(description="The k nearest scans, nearest first.")
    runner_up: MatchOut | None = Field(description="The nearest scan away from the best one.")
    ratio: float | None = Field(description="Distance of the best over that of the runner-up.")
    segments_searched: list[int]

    @classmethod
    def from_core(cls, found: Localization, live_revision: str) -> "LocalizationOut":
        """Show an answer."""
        deviation, covariance = found.deviation, found.position_covariance_m2
        return cls(
            revision=found.revision,
            live_revision=live_revision,
            localized=found.localized,
            reason=found.verdict.reason,
            probability=found.verdict.probability,
            along_std_m=None if deviation is None else deviation.along_m,
            lateral_std_m=None if deviation is None else deviation.lateral_m,
            heading_std_deg=(
                None
                if deviation is None or found.best.heading_deg is None
                else deviation.heading_deg
            ),
            position_covariance=(
                None
                if covariance is None
                else CovarianceOut(xx_m2=covariance[0], xy_m2=covariance[1], yy_m2=covariance[2])
            ),
            best=MatchOut.from_core(found.best),
            matches=[MatchOut.from_core(match) for match in found.matches],
            runner_up=None if found.runner_up is None else MatchOut.from_core(found.runner_up),
            ratio=found.ratio,
            segments_searched=list(found.segments),
        )
