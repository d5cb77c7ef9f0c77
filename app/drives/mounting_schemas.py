"""The mounting of a sensor over the wire."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.http.exact_types import Number
from app.http.shown import Shown
from core.scans.mounting import FARTHEST_M, HIGHEST_M, Mounting

_TURN: Any = {"ge": -360, "le": 360}
_ASIDE: Any = {"ge": -FARTHEST_M, "le": FARTHEST_M}


class MountingIn(BaseModel):
    """Position and orientation of a sensor in the vehicle's frame: x forward, y left, z up."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"example": {"x_m": 1.2, "y_m": 0.0, "z_m": 1.9, "pitch_deg": 5.0}},
    )

    x_m: Number = Field(**_ASIDE, description="Distance ahead of the vehicle's origin.")
    y_m: Number = Field(**_ASIDE, description="Distance to the left of the vehicle's origin.")
    z_m: Number = Field(gt=0, lt=HIGHEST_M, description="Height above the ground.")
    roll_deg: Number = Field(0.0, **_TURN, description="Rotation about x: right side down.")
    pitch_deg: Number = Field(
        0.0, **_TURN, description="Rotation about y, after the roll: front down."
    )
    yaw_deg: Number = Field(
        0.0, **_TURN, description="Rotation about z, after both: counter-clockwise."
    )

    def to_core(self) -> Mounting:
        """Return the mounting."""
        return Mounting(**self.model_dump())


class MountingOut(Shown):
    """Position and orientation of a drive's sensor in the vehicle's frame."""

    x_m: float
    y_m: float
    z_m: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
