"""Revisions and bases on the wire."""

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.http.shown import Shown
from app.maps.schemas import MapOut
from app.revisions.shown_parameters import ShownParameters
from core.encodings.basis import Basis
from core.parameters import MapParameters
from core.text import shown
from storage.catalog import RevisionRecord


class RevisionOut(Shown):
    """One immutable build of a map."""

    revision: str = Field(description="Digest of its content.")
    live: bool
    encoding: str
    scans: int
    segments: int
    parameters: dict[str, Any] = Field(description="Parameters of its build.")
    size_bytes: int
    job: str | None
    created_at: datetime

    @classmethod
    def from_record(cls, record: RevisionRecord, live_revision: str | None) -> "RevisionOut":
        """Return the model of a revision's record."""
        return cls.of(
            record,
            revision=record.digest,
            live=record.digest == live_revision,
            # An early version accepted names that are not valid UTF-8.
            parameters={str(shown(k)): shown(v) for k, v in record.parameters.items()},
            job=record.job_id,
        )


class LiveIn(BaseModel):
    """The revision to make live."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"revision": "0f" * 32}}
    )

    revision: str = Field(
        max_length=64, description="The revision's digest, or at least its first 12 digits."
    )


class LiveOut(MapOut):
    """A map of which another revision was made live."""

    notes: list[str] = Field(
        description="Notes for the client: that the map's anchor is of another frame than that of"
        " this revision."
    )


class SegmentBasisOut(BaseModel):
    """The bases of one segment."""

    segment: int
    elevation_basis: list[list[float]] = Field(description="U, I rows of r1 numbers.")
    azimuth_basis: list[list[float]] = Field(description="V, J rows of r2 numbers.")


def _all_required(schema: dict[str, Any]) -> None:
    # Every answer has all fields; of an earlier service's some are missing where one is read.
    schema["required"] = list(schema["properties"])


class BasisOut(BaseModel):
    """What a vehicle needs to make signatures; it contains no places."""

    model_config = ConfigDict(json_schema_extra=_all_required)

    revision: str = Field(description="The revision; empty of a shared basis, which is of no map.")
    basis: str = Field(
        description="Digest of the basis, which signatures made with it name. Revisions with the"
        " same basis have the same digest."
    )
    parameters: ShownParameters = Field(
        description="Encoding, sensor, grid, reducer and ranks; of a harmonic map also the image's"
        " kind and how signatures are compared."
    )
    segments: list[SegmentBasisOut] = Field(
        description="The paper's bases, one entry a segment; none of a harmonic map."
    )
    radial_basis: list[list[float]] | None = Field(
        None,
        description="U of a harmonic map, I rows, null of others. A signature of r1 rows uses the"
        " first r1 columns; a map of any views has more than its `ranks`. The azimuth factor is a"
        " formula: f_m(j) = exp(-2 pi i m j / J) / sqrt(J), m < r2.",
    )
    least_cells: int | None = Field(
        None,
        description="A scan whose image has fewer occupied cells is not to be sent: as a scan it"
        " is refused as `too_few_returns`. 0 of a map without calibration, null of a shared basis."
        " Revisions with the same basis differ in it: the header `TensorMap-Least-Cells` has it"
        " too, of every answer.",
    )

    @classmethod
    def from_core(cls, basis: Basis, least_cells: int | None = None) -> "BasisOut":
        """Return the model of bases, with that of their map; JSON keeps each float32 exactly."""
        return cls(
            revision=basis.revision,
            basis=basis.digest,
            parameters=basis.parameters.as_attributes(),
            least_cells=least_cells,
            **{"segments": [], **basis.as_values()},
        )

    def to_core(self) -> Basis:
        """Return the bases.

        Raises:
            InvalidMap: If they do not fit the parameters.
        """
        parameters = MapParameters.from_attributes(self.parameters)
        return parameters.encoder.read_basis(
            self.revision, self.basis, parameters, self.model_dump()
        )
