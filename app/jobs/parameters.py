"""What a build is asked for, as the catalog keeps it."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from core.imager import ImageKind
from core.parameters import LATERAL_RENDERINGS_M, Distance, Encoding, MapParameters, Segmentation
from core.projection import Reducer
from core.segmentation import PAPER_SEGMENT_LENGTH
from core.sensor import HDL_64E, SENSORS

__all__ = ["BuildParameters"]

_MOST = 2**31 - 1  # scans


class BuildParameters(BaseModel):
    """How a map is built; the paper's values are the defaults, or the harmonic encoding's own."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "example": {"drives": ["monday"], "segments": 5},
            "examples": [{"encoding": "harmonic", "lateral_renderings_m": [-3, -1.5, 0, 1.5, 3]}],
        },
    )

    drives: (
        Annotated[
            list[Annotated[str, Field(max_length=64)]],
            Field(min_length=1, max_length=1000, fail_fast=True),
        ]
        | None
    ) = Field(None, description="Which drives, in this order; all of the map by default.")
    encoding: Encoding = Field(
        Encoding.PAPER,
        description="`paper`: bases of each segment; `harmonic`: one for the map.",
    )
    ranks: tuple[int, int] = Field((5, 5), description="r1 and r2: the shape of a signature.")
    segmentation: Segmentation = Field(
        Segmentation.FIXED,
        description="`fixed`: k scans each; `unequal`: k/2 to 2k, ending where the drive turns or"
        " one model explains the scans no more. Where drives meet both are cut besides.",
    )
    segment_length: int | None = Field(
        None,
        ge=1,
        le=_MOST,
        description=f"k, scans in a segment; {PAPER_SEGMENT_LENGTH} without it and `segments`.",
    )
    segments: int | None = Field(
        None,
        ge=1,
        le=_MOST,
        description="L instead: k = ceil(K / L) of the longest drive's K scans.",
    )
    reducer: Reducer | None = Field(
        None,
        description="What a shared cell keeps: `last`, `nearest`, `farthest` or `mean` range,"
        " `mean` or `highest` height. By default `last`; in a harmonic map `mean`.",
    )
    image: ImageKind | None = Field(
        None, description="What is encoded. By default `range`; in a harmonic map `height`."
    )
    distance: Distance | None = Field(
        None, description="How harmonic signatures are compared; `normalised` by default."
    )
    lateral_renderings_m: list[float] | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="From where a harmonic map's scans are rendered, metres to the left, rising;"
        f" {list(LATERAL_RENDERINGS_M)} by default, [0] for none.",
    )
    sensor: str = Field(HDL_64E.name, description=f"One of {', '.join(sorted(SENSORS))}.")
    sensor_height_m: float = Field(1.73, gt=0, lt=100, description="Sensor above ground.")
    make_live: bool = Field(
        default=False, description="Make the result live; the first one always is."
    )

    @model_validator(mode="after")
    def _one_way_to_cut(self) -> "BuildParameters":
        if self.segment_length is not None and self.segments is not None:
            raise ValueError("give segment_length or segments, not both")
        return self

    @field_validator("drives")
    @classmethod
    def _each_once(cls, drives: list[str] | None) -> list[str] | None:
        if drives is not None and len(set(drives)) < len(drives):
            raise ValueError("a drive comes twice")
        return drives

    def map_parameters(self) -> MapParameters:
        """Return what the map will keep.

        Raises:
            InvalidParameters: If the sensor is unknown, a rank does not fit its grid or something
                is not of this encoding.
        """
        return MapParameters.for_sensor(
            self.sensor,
            encoding=self.encoding,
            ranks=self.ranks,
            reducer=self.reducer,
            sensor_height_m=self.sensor_height_m,
            image=self.image,
            distance=self.distance,
            lateral_renderings_m=self.lateral_renderings_m,
            segmentation=self.segmentation,
        )

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return self.model_dump(mode="json")
