"""Signatures on the wire, as queries of one scan or several."""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)
from pydantic.json_schema import SkipJsonSchema

from app.http.exact_types import Number, integers
from core.encodings.registry import encoding_named, encoding_names
from core.encodings.signature import Signature
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
                {
                    "basis": "0f" * 32,
                    "signatures": [{"segment": 3, "values": [[950.1, -3.2], [12.5, 60.8]]}],
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
