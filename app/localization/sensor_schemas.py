"""Query parameters of scans: the sensor of the query, how it is mounted and tilted."""

from typing import Any

from pydantic import BaseModel, Field, field_validator

from core.errors import InvalidParameters
from core.scans.mounting import Mounting
from core.scans.tilt import STEEPEST_DEG, Tilt
from storage.formats.scans.registry import FORMAT_NAMES

_angle_deg: dict[str, Any] = {"ge": -STEEPEST_DEG, "le": STEEPEST_DEG, "allow_inf_nan": False}


class SensorIn(BaseModel):
    """How the query's sensor is mounted and tilted, and what its files are."""

    sensor_height_m: float | None = Field(
        None,
        gt=0,
        lt=100,
        description="Height of the query's sensor above ground, metres, if it is not the map's;"
        " only maps of height images depend on it.",
    )
    mounting: str | None = Field(
        None,
        max_length=200,
        description="Mounting of the query's sensor in the vehicle's frame, x,y,z,roll,pitch,yaw,"
        " metres and degrees; z is its height above ground. The answer is then the vehicle's pose."
        " Without it the vehicle's frame is the sensor's.",
        examples=["1.2,0,1.9,0,5,0"],
    )
    roll_deg: float | None = Field(
        None,
        **_angle_deg,
        description="Roll of the vehicle against gravity, right side down, with `pitch_deg`; of the"
        " sensor where there is no mounting. The scan is levelled by both, and not by the ground"
        " that it sees.",
    )
    pitch_deg: float | None = Field(
        None, **_angle_deg, description="Pitch against gravity, front down, with `roll_deg`."
    )
    format_name: str | None = Field(
        None,
        alias="format",
        description="Format of a scan without a Content-Type, or of those scans of a tar whose"
        " suffix says none, as `.bin`: the last word of a media type, as `kitti`.",
        json_schema_extra={"enum": list(FORMAT_NAMES)},
    )

    @field_validator("format_name")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in FORMAT_NAMES:
            raise ValueError(f"wanted one of {', '.join(FORMAT_NAMES)}")
        return name

    def to_mounting(self) -> Mounting | None:
        """Return the mounting, `None` if the vehicle's frame is the sensor's.

        Raises:
            InvalidParameters: If the text is not a mounting, or the height is given twice.
        """
        if self.mounting is None:
            return None
        if self.sensor_height_m is not None:
            raise InvalidParameters(
                f"sensor_height_m is {self.sensor_height_m:g} and the mounting has a height too:"
                " give one of them"
            )
        return Mounting.from_text(self.mounting)

    def to_tilt(self) -> Tilt | None:
        """Return the tilt against gravity, `None` if it did not come.

        Raises:
            InvalidParameters: If only one of the angles came.
        """
        return Tilt.of(self.roll_deg, self.pitch_deg)
