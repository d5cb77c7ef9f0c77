"""Query parameters of a localization: priors, and how to answer."""

from typing import Annotated

from pydantic import BaseModel, Field

from app.http.answer_fields import MOST_FIELDS_CHARACTERS, known_fields
from app.localization.schemas import LocalizationOut
from app.localization.sensor_schemas import SensorIn
from core.errors import InvalidParameters
from core.localization.priors import (
    HeadingPrior,
    OdometryPrior,
    PositionPrior,
    Priors,
    ScanOfMap,
)
from core.projection.imager import ImageKind

_MOST_SEGMENTS = 10_000


class PriorsIn(BaseModel):
    """What the vehicle knows of its place before the search."""

    x_m: float | None = Field(None, description="Approximate x in the map's frame; requires `y_m`.")
    y_m: float | None = Field(None, description="Approximate y in the map's frame; requires `x_m`.")
    position_sigma_m: float | None = Field(
        None, description="Standard deviation of x and y; required with them."
    )
    heading_deg: float | None = Field(
        None, description="Approximate heading, counter-clockwise from the map's x."
    )
    heading_sigma_deg: float | None = Field(
        None, description="Standard deviation of the heading; required with it."
    )
    travelled_m: float | None = Field(
        None,
        description="Distance driven since the last localization, in metres: the most that a scan"
        " can be away.",
    )
    travelled_sigma_m: float | None = Field(
        None,
        description="Standard deviation of `travelled_m`, with that of the last localization;"
        " required with it.",
    )
    since_drive: str | None = Field(
        None,
        max_length=64,
        description="Last localization: the drive of its scan; requires `since_scan`.",
    )
    since_scan: int | None = Field(
        None,
        ge=0,
        le=2**31 - 1,
        description="Last localization: the `scan_index` of its scan; requires `since_drive`.",
    )
    since_x_m: float | None = Field(
        None, description="Last localization: its x in the map's frame, in place of a scan."
    )
    since_y_m: float | None = Field(
        None, description="Last localization: its y in the map's frame; requires `since_x_m`."
    )
    segment: list[Annotated[int, Field(ge=0, le=2**31 - 1)]] | None = Field(
        None,
        max_length=_MOST_SEGMENTS,
        description="The vehicle is on this segment, or, repeated, on one of them.",
    )

    def to_core(self) -> Priors:
        """Return the priors.

        Raises:
            InvalidParameters: If a prior is incomplete, or a number is out of its range.
        """
        position = self._prior_of("x_m", "y_m", "position_sigma_m")
        heading = self._prior_of("heading_deg", "heading_sigma_deg")
        travelled = self._prior_of("travelled_m", "travelled_sigma_m")
        place = self._prior_of("since_x_m", "since_y_m")
        if (self.since_drive is None) != (self.since_scan is None):
            raise InvalidParameters("since_drive and since_scan are one scan: give both or none")
        since: ScanOfMap | tuple[float, float] | None = None
        if self.since_drive is not None and self.since_scan is not None:
            since = ScanOfMap(self.since_drive, self.since_scan)
        elif place:
            since = place[0], place[1]
        if bool(travelled) != (since is not None) or (place and since != place):
            raise InvalidParameters(
                "travelled_m and travelled_sigma_m need one last localization: since_drive and"
                " since_scan, or since_x_m and since_y_m"
            )
        return Priors(
            PositionPrior(*position) if position else None,
            HeadingPrior(*heading) if heading else None,
            OdometryPrior(since, *travelled) if travelled and since else None,
            None if self.segment is None else tuple(self.segment),
        )

    def _prior_of(self, *names: str) -> tuple[float, ...]:
        """Return the numbers of one prior, empty if none is given."""
        given = tuple(v for name in names if (v := getattr(self, name)) is not None)
        if given and len(given) < len(names):
            missing = ", ".join(name for name in names if getattr(self, name) is None)
            raise InvalidParameters(f"a prior is incomplete: it lacks {missing}")
        return given


class AnswerQuery(BaseModel):
    """Query parameters of what to answer."""

    k: int = Field(1, ge=1, le=1000, description="Number of matches to return.")
    min_probability: float | None = Field(
        None,
        ge=0,
        le=1,
        description="Least probability to accept; the map's own threshold by default, 0 to refuse"
        " nothing for its probability.",
    )
    fields: Annotated[str, known_fields(LocalizationOut)] | None = Field(
        None,
        max_length=MOST_FIELDS_CHARACTERS,
        description="The fields to answer with, separated by commas, as"
        " `localized,best.estimated_pose`; all without it.",
    )


class LocalizeQuery(AnswerQuery, PriorsIn):
    """Query parameters of every localization."""


class _SensorQuery(LocalizeQuery):
    sensor: str | None = Field(
        None, description="The query's sensor; refused if it is not the map's."
    )


class ScanQuery(_SensorQuery, SensorIn):
    """Query parameters of the localization of a scan."""


class ImageQuery(_SensorQuery):
    """Query parameters of the localization of an image."""

    image: ImageKind | None = Field(
        None, description="The image's kind; refused if it is not the map's."
    )
