"""Revisions and bases over the wire."""

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from core.encodings.basis import Basis
from core.parameters import MapParameters
from core.text import shown
from storage.catalog import RevisionRecord


class RevisionOut(BaseModel):
    """One immutable build of a map."""

    revision: str = Field(description="Digest of its content.")
    live: bool
    encoding: str
    scans: int
    segments: int
    parameters: dict[str, Any] = Field(description="What it was built with.")
    size_bytes: int
    job: str | None
    created_at: datetime

    @classmethod
    def from_record(cls, record: RevisionRecord, live_revision: str | None) -> "RevisionOut":
        """Show a revision's record."""
        return cls(
            revision=record.digest,
            live=record.digest == live_revision,
            encoding=record.encoding,
            scans=record.scans,
            segments=record.segments,
            # A name that an earlier version let in is shown with what UTF-8 has of it.
            parameters={str(shown(k)): shown(v) for k, v in record.parameters.items()},
            size_bytes=record.size_bytes,
            job=record.job_id,
            created_at=record.created_at,
        )


class LiveIn(BaseModel):
    """Which revision is to answer from now on."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"revision": "0f" * 32}}
    )

    revision: str = Field(max_length=64, description="Its digest, or at least 12 first digits.")


class SegmentBasisOut(BaseModel):
    """The bases of one segment."""

    segment: int
    elevation_basis: list[list[float]] = Field(description="U, I rows of r1 numbers.")
    azimuth_basis: list[list[float]] = Field(description="V, J rows of r2 numbers.")


class BasisOut(BaseModel):
    """What a vehicle needs to make signatures: no place can be read from it."""

    revision: str
    basis: str = Field(
        description="Digest of the basis: what signatures made with it name. Revisions that share"
        " the basis share it."
    )
    parameters: dict[str, Any] = Field(
        description="Encoding, sensor, grid, reducer and ranks; of a harmonic map also the image's"
        " kind and how signatures are compared."
    )
    segments: list[SegmentBasisOut] = Field(
        description="The paper's bases, one entry a segment; none of a harmonic map."
    )
    radial_basis: list[list[float]] | None = Field(
        None,
        description="U of a harmonic map, I rows of r1 numbers. The azimuth factor is a formula:"
        " f_m(j) = exp(-2 pi i m j / J) / sqrt(J), m < r2.",
    )

    @classmethod
    def from_core(cls, basis: Basis) -> "BasisOut":
        """Show bases as JSON; a float32 survives it."""
        return cls(
            revision=basis.revision,
            basis=basis.digest,
            parameters=basis.parameters.as_attributes(),
            **{"segments": [], **basis.as_values()},
        )

    def to_core(self) -> Basis:
        """Return the bases, as a vehicle uses them.

        Raises:
            InvalidMap: If they do not fit the parameters.
        """
        parameters = MapParameters.from_attributes(self.parameters)
        return parameters.encoder.read_basis(
            self.revision, self.basis, parameters, self.model_dump()
        )
