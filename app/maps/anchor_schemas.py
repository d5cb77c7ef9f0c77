"""Tracks of GNSS receivers over the wire."""

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Strict

from app.http.exact_types import Number, Seconds
from core.frames.gnss import GnssTrack
from core.numbers import nan_if_none

MOST_FIXES = 9_000


class GnssFixIn(BaseModel):
    """A position by a GNSS receiver."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    time_s: Annotated[Seconds, Strict()] = Field(
        description="Time in seconds, by the clock of the drive's scans."
    )
    latitude_deg: Number = Field(ge=-90, le=90, description="Latitude, WGS84.")
    longitude_deg: Number = Field(ge=-180, le=180, description="Longitude, WGS84.")
    altitude_m: Number | None = Field(
        None,
        ge=-1e5,
        le=1e5,
        description="Altitude above the ellipsoid. The anchor's is the median of those given; if"
        " no fix has one, it is unknown, and is 0.",
    )
    accuracy_m: Number | None = Field(
        None, gt=0, le=1e4, description="Standard deviation of the position, if known."
    )


class GnssTrackIn(BaseModel):
    """The track of a GNSS receiver on one of the map's drives."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "drive": "monday",
                "fixes": [
                    {"time_s": 0.0, "latitude_deg": 49.01, "longitude_deg": 8.4},
                    {"time_s": 1.0, "latitude_deg": 49.0101, "longitude_deg": 8.4},
                ],
            }
        },
    )

    drive: Annotated[str, Field(max_length=64)] = Field(
        description="A drive of the live revision, with poses and times."
    )
    fixes: list[GnssFixIn] = Field(min_length=1, max_length=MOST_FIXES, fail_fast=True)

    def to_core(self) -> GnssTrack:
        """Return the fixes in the order of time."""
        fixes = sorted(self.fixes, key=lambda fix: fix.time_s)
        return GnssTrack(
            np.array([fix.time_s for fix in fixes]),
            np.array([(f.latitude_deg, f.longitude_deg, nan_if_none(f.altitude_m)) for f in fixes]),
            np.array([nan_if_none(fix.accuracy_m) for fix in fixes]),
        )
