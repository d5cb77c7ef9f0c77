"""Signatures and localizations on the wire."""

from collections.abc import Sequence
from typing import Annotated, Any

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
from app.http.shown import Shown
from core.confidence.decision import Refusal
from core.encodings.registry import encoding_named, encoding_names
from core.encodings.signature import Signature
from core.localization.localizer import Localization
from core.localization.match import Match
from core.mapping.georeference import NOWHERE, Georeference
from core.projection.visibility import MOST_RINGS, SECTORS

MOST_QUERIES = 1000
"""The most queries of one batch."""
_OTHER = "other"
_SIGNATURE_TAGS = {"paper", "harmonic", _OTHER}

# Bounds as in the packed form; validation of a list stops at its first error.
_Row = Annotated[list[Number], Field(max_length=255, fail_fast=True)]
_Rows = Annotated[list[_Row], Field(min_length=1, max_length=255, fail_fast=True)]
_Digest = Annotated[str, Field(pattern="^[0-9a-f]{16,64}$")]


class SegmentSignatureIn(BaseModel):
    """A signature, and the segment with whose bases it was made."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    segment: int = Field(ge=0, le=0xFFFF)
    values: _Rows = Field(description="r1 rows of r2 numbers.")

    _integers = field_validator("segment", mode="before")(integers)


class HarmonicSignatureIn(BaseModel):
    """A signature made with a harmonic map's basis, for all its segments."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    values_real: _Rows = Field(description="Real parts, r1 rows of r2 numbers.")
    values_imag: _Rows = Field(
        description="Imaginary parts, of the same shape; the first column is 0."
    )
    hidden: list[int] = Field(
        [],
        max_length=SECTORS,
        description="Sectors of 6 degrees that the scan did not see, rising; sector 0 begins where"
        " the image does. The values are those of the others.",
    )

    rings: int | None = Field(
        None,
        ge=1,
        le=MOST_RINGS,
        description="How many rings of the image are within the scan's reach, if not all. The"
        " values are those of these rings.",
    )

    _integers = field_validator("hidden", "rings", mode="before")(integers)


def _of_registered(item: dict[str, Any]) -> dict[str, Any]:
    name = item["encoding"]
    if not isinstance(name, str) or name in _SIGNATURE_TAGS or name not in encoding_names():
        raise ValueError("no encoding of that name is registered besides ours")
    return item


# Of a registered encoding besides ours, which reads the other fields itself.
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
    """One scan's signatures, made with one basis; one signature for a harmonic map.

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

    basis: _Digest | None = Field(
        None,
        description="Digest of their basis, or at least 16 first digits: any revision"
        " that has it answers, the live one first.",
    )
    revision: _Digest | None = Field(
        None, description="Digest of the revision that answers, in place of the basis."
    )
    signatures: list[SignatureIn] = Field(min_length=1, max_length=0x10000, fail_fast=True)

    @model_validator(mode="after")
    def _one_name(self) -> "SignaturesIn":
        if (self.basis is None) == (self.revision is None):
            got = "neither" if self.basis is None else "both"
            raise ValueError(f"wanted basis or revision, got {got}")
        return self

    @property
    def named(self) -> str:
        """The basis or revision that they name."""
        return self.basis or self.revision or ""

    @classmethod
    def from_core(cls, signatures: Sequence[Signature]) -> "SignaturesIn":
        """Return the model of signatures made with one basis."""
        return cls(
            basis=signatures[0].revision,
            signatures=[
                encoding_named(signature.encoding).as_values(signature) for signature in signatures
            ],
        )

    def to_core(self) -> tuple[Signature, ...]:
        """Return the signatures.

        Raises:
            InvalidSignature: If the rows of one differ in length or a number is beyond float32.
        """
        signatures = []
        for item in self.signatures:
            values = dict(item) if isinstance(item, dict) else item.model_dump()
            encoding = encoding_named(values.pop("encoding", _form_of(item)))
            signatures.append(encoding.from_values(values, self.named))
        return tuple(signatures)


class BatchIn(BaseModel):
    """Several queries by signatures, of one scan each."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "queries": [
                    {
                        "basis": "0f" * 32,
                        "signatures": [{"segment": 3, "values": [[950.1, -3.2], [12.5, 60.8]]}],
                    }
                ]
            }
        },
    )

    queries: list[SignaturesIn] = Field(min_length=1, max_length=MOST_QUERIES, fail_fast=True)


class MatchOut(Shown):
    """A scan of the map, and where the query is relative to it."""

    segment: int
    fraction: float = Field(description="Position in the segment: 0 at its start, 1 at its end.")
    along_m: float | None = Field(
        description="Position in the segment in metres; null without poses."
    )
    drive: str
    scan_index: int = Field(description="The scan's index in that drive.")
    distance: float = Field(
        description="Distance between the signatures: Frobenius; in a harmonic map the one it was"
        " built with."
    )
    timestamp_s: float | None
    pose: PoseOut | None
    turn_deg: float | None = Field(
        validation_alias=AliasChoices("turn_deg", "relative_yaw_deg"),
        description="Relative yaw of the query, counter-clockwise, -180..180; null in the paper's"
        " encoding.",
    )
    lateral_m: float | None = Field(
        description="Lateral offset of the query, positive to the left of that scan; null in the"
        " paper's encoding."
    )
    heading_deg: float | None = Field(
        description="Estimated heading of the query in the world; null in the paper's encoding or"
        " without poses."
    )
    estimated_pose: PoseOut | None = Field(
        description="Estimated pose of the query, between scans and beside them; null in the"
        " paper's encoding or without poses."
    )


class CovarianceOut(Shown):
    """Covariance of the position, in the map's frame."""

    xx_m2: float
    xy_m2: float
    yy_m2: float


class LocalizationOut(Shown):
    """Where the query was recorded.

    It has the nearest scan also if the query is refused: only with `localized` true is that the
    place.
    """

    revision: str = Field(description="The revision that answered.")
    live_revision: str = Field(description="The revision that is live now.")
    localized: bool = Field(description="Whether the best match is accepted.")
    reason: Refusal | None = Field(
        description="Why the best match is not accepted. `unknown_place`: no scan is near enough;"
        " `ambiguous`: one is, but another place is nearly as near; `too_few_returns`: the image"
        " has too few occupied cells, or its view is too small; `outside_prior`: no scan is within"
        " the priors, or one outside of them matches far better; `not_calibrated`:"
        " `min_probability` was given, and the map has no calibration."
    )
    probability: float | None = Field(
        description="Probability that the best match is right, if a query is as likely in the map"
        " as elsewhere; null from a map that is not calibrated: it refuses nothing."
    )
    along_std_m: float | None = Field(
        description="Standard deviation of the position along the path, if the match is right; null"
        " without calibration or poses."
    )
    lateral_std_m: float | None = Field(
        description="Standard deviation of the position across the path, if the match is right."
    )
    heading_std_deg: float | None = Field(
        description="Standard deviation of the heading, if the match is right; null in the paper's"
        " encoding."
    )
    position_covariance: CovarianceOut | None = Field(
        description="Covariance of the position in the map's frame."
    )
    best: MatchOut
    matches: list[MatchOut] = Field(
        description="The k nearest scans, nearest first; with priors the most likely first."
    )
    runner_up: MatchOut | None = Field(description="The nearest scan away from the best one.")
    ratio: float | None = Field(
        description="Distance of the best match divided by that of the runner-up."
    )
    segments_searched: list[int]

    @classmethod
    def from_core(
        cls, found: Localization, live_revision: str, georeference: Georeference = NOWHERE
    ) -> "LocalizationOut":
        """Return the model of a localization.

        Of plain values: each heading is computed once, and pydantic validates all in one call.
        """
        deviation, decision = found.deviation, found.decision
        matches = [match_values(match, georeference) for match in found.matches]
        best = matches[0]
        return cls.model_validate(
            {
                "revision": found.revision,
                "live_revision": live_revision,
                "localized": decision.localized,
                "reason": decision.reason,
                "probability": decision.probability,
                "along_std_m": deviation and deviation.along_m,
                "lateral_std_m": deviation and deviation.lateral_m,
                "heading_std_deg": deviation.heading_deg
                if deviation and best["heading_deg"] is not None
                else None,
                "position_covariance": found.position_covariance_m2,
                "best": best,
                "matches": matches,
                "runner_up": found.runner_up and match_values(found.runner_up, georeference),
                "ratio": found.ratio,
                "segments_searched": found.segments,
            }
        )


def match_values(match: Match, georeference: Georeference = NOWHERE) -> dict[str, Any]:
    """Return plain values of a `MatchOut`."""
    estimated = georeference.pose(match.drive, match.estimated_pose)
    yaw_known = match.relative_yaw_deg is not None
    return {
        **vars(match),
        "pose": georeference.pose(match.drive, match.pose),
        "estimated_pose": estimated,
        "heading_deg": estimated["yaw_deg"] if estimated and yaw_known else None,
    }


class BatchOut(BaseModel):
    """The answers to several queries."""

    items: list[LocalizationOut] = Field(description="The answers in the order of the queries.")
