"""The parameters of a build, as requested and as the catalog stores them."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    computed_field,
    field_validator,
    model_validator,
)
from pydantic_core import to_jsonable_python

from app.builds.encoding_names import EncodingName
from app.http.exact_types import Flag, Number, integers
from core.encodings.distance import Distance
from core.encodings.registry import DEFAULT_ENCODING
from core.errors import InvalidParameters
from core.parameters import MapParameters, Segmentation
from core.projection.imager import LATERAL_RENDERINGS_M, ImageKind, Views
from core.projection.reducer import Reducer
from core.scans.sensor import HDL_64E, SENSORS, sensor_named
from core.segmentation.fitting import SEGMENT_M, SEGMENT_SCANS
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH
from storage.names import PREFIX_PATTERN

_MOST = 2**31 - 1  # scans
_OF_MAP = (
    "encoding",
    "ranks",
    "segmentation",
    "reducer",
    "image",
    "distance",
    "lateral_renderings_m",
    "views",
    "verification_images",
    "sensor",
    "sensor_height_m",
)
"""The parameters that the map stores."""
_OF_BASE = frozenset({*_OF_MAP, "segment_length"})
"""The parameters that a build takes from its `base`."""


class Align(StrEnum):
    """What a build does with drives whose poses are in different world frames."""

    AUTO = "auto"
    CHECK = "check"
    OFF = "off"


_OF_POSES: dict[object, tuple[Align, ...]] = {
    "checked": (Align.CHECK, Align.AUTO),
    "unchecked": (Align.OFF,),
}
"""What `poses` of earlier releases means as `align`, and which values of `align` it allows."""


DriveNames = Annotated[
    list[Annotated[str, Field(max_length=64)]],
    Field(min_length=1, max_length=1000, fail_fast=True),
]


def _describe(schema: dict[str, Any]) -> None:
    """Add examples, and `poses`: one schema describes what is sent and what is answered."""
    schema["examples"] = [
        {"drives": ["monday"], "segments": 5},
        {"encoding": "harmonic", "lateral_renderings_m": [-3, -1.5, 0, 1.5, 3]},
        {"base": "live", "add": ["tuesday"], "remove": ["monday"]},
    ]
    schema["properties"]["poses"] = {
        "type": "string",
        "enum": ["checked", "unchecked"],
        "description": "`align` as earlier releases had it; it may be sent, too.",
        "deprecated": True,
        "readOnly": True,
    }


class BuildParameters(BaseModel):
    """How a map is built; the paper's values are the defaults, or the harmonic encoding's own."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra=_describe,
    )

    drives: DriveNames | None = Field(
        None, description="Which drives, in this order; all of the map that have scans by default."
    )
    base: Annotated[str, Field(pattern=f"^(live|{PREFIX_PATTERN})$")] | None = Field(
        None,
        description="`live`, or the digest of a revision: its drives and parameters, changed by"
        " `add` and `remove`.",
    )
    add: DriveNames | None = Field(
        None, description="Drives to put after those of `base`; one that it has is read again."
    )
    remove: DriveNames | None = Field(None, description="Drives of `base` to leave out.")
    max_age_days: Number | None = Field(
        None,
        gt=0,
        le=36525,
        description="Leave out drives whose upload began longer ago. They stay stored.",
    )
    refit: Flag = Field(
        default=False,
        description="Fit a new basis of a harmonic map: vehicles have to download it again. By"
        " default that of `base`, or of the live revision if its parameters are the same, is kept.",
    )
    basis: Annotated[str, Field(pattern="^[0-9a-z._-]{1,64}$")] | None = Field(
        None,
        description="Name or digest of a shared basis to use instead: vehicles with it are answered"
        " by all maps that have it, also by `POST /v1/localizations/signature` without a map.",
    )
    encoding: EncodingName = Field(
        DEFAULT_ENCODING,
        description="`harmonic`: one basis for the map, answers in any direction and lane; `paper`:"
        " bases of each segment.",
    )
    ranks: tuple[int, int] | None = Field(
        None,
        description="r1 and r2: the shape of a signature; 6 and 7 for any views, else 5 and 5.",
    )
    segmentation: Segmentation = Field(
        Segmentation.FIXED,
        description="`fixed`: k scans each; `unequal`: k/2 to 2k, ending where the drive turns or"
        " one model no longer fits the scans. Both are also cut where drives meet.",
    )
    segment_length: int | None = Field(
        None,
        ge=1,
        le=_MOST,
        description="k, scans in a segment, at least 2 if a drive has more than one. Without it and"
        f" `segments` a fifth of the longest drive, but at least {SEGMENT_M:g} m, without poses"
        f" {SEGMENT_SCANS} scans, and at most {PAPER_SEGMENT_LENGTH} scans.",
    )
    segments: int | None = Field(
        None,
        ge=1,
        le=_MOST,
        description="L instead: k = ceil(K / L) of the longest drive's K scans; at most K / 2."
        " Turns, in harmonic maps, and places where drives meet add segments.",
    )
    reducer: Reducer | None = Field(
        None,
        description="What a shared cell keeps: `last`, `nearest`, `farthest` or `mean` range,"
        " `mean` or `highest` height. By default `highest`, of ranges `mean`; of paper `last`.",
    )
    image: ImageKind | None = Field(
        None, description="Kind of image. By default `height`; in a paper map `range`."
    )
    distance: Distance | None = Field(
        None, description="How harmonic signatures are compared; `normalised` by default."
    )
    lateral_renderings_m: list[Number] | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="From where a harmonic map's scans are rendered, metres to the left, rising;"
        f" {list(LATERAL_RENDERINGS_M)} by default, [0] for none.",
    )
    views: Views | None = Field(
        None,
        description="`any`: scans are levelled, and queries say which sectors are hidden from them;"
        " `full`: queries are level and see all around. By default as the live revision of the"
        " same encoding and image, else `any` where they can be: in harmonic maps of heights.",
    )
    verification_images: Flag | None = Field(
        None,
        description="Whether a map of `any` views keeps a small image of each scan, 60 bytes a"
        " ring: the best candidates of a scan or image query are compared with them cell by cell."
        " By default as the live revision, if its `views` are taken, else where `views` is `any`.",
    )
    sensor: str = Field(
        HDL_64E.name,
        description="The sensor that recorded the drives. Range images have its elevations; maps of"
        " height images store its name, and take its usual height where `sensor_height_m` is not"
        f" given. One of {', '.join(sorted(SENSORS))}.",
    )
    sensor_height_m: Number | None = Field(
        None,
        gt=0,
        lt=100,
        description="Height of the sensor above the ground in metres, for drives without a"
        f" mounting; {HDL_64E.height_m} by default, the usual height of {HDL_64E.name}. For any"
        " other sensor this is an assumption, and the job notes it.",
    )
    align: Align = Field(
        Align.CHECK,
        description="`check`: the scans of each drive are matched with those before it, and the"
        " build fails with `frames-disagree` if the poses of one are in another world frame;"
        " `auto`: such poses are brought into one frame in the map, if one transform of a drive"
        " explains its matches; `off` omits both. Without `off`, a build also fails with"
        " `poses-contradict-scans` if the poses of a drive are not those of its scans. It is not"
        " taken from `base`, whose transforms stay, and whose drives are not matched again if all"
        " of them were found in one frame and have the same poses. Drives whose poses were computed"
        " from their scans are always aligned.",
    )
    odometry: Flag = Field(
        default=True,
        description="Compute the poses of drives that came without, once: they are stored with the"
        " drive until poses are put. Without, everything of such a drive is in scan indices.",
    )
    make_live: Flag = Field(
        default=False,
        description="Make the result live unless its recall is below the live revision's, on old or"
        " on new drives, or cannot be measured; the first one always becomes live.",
    )
    max_recall_loss: Number = Field(
        0.02,
        ge=0,
        le=1,
        description="By how much recall on the scans that both have may be lower than the live"
        " revision's; beyond, the result of `make_live` is done but not live. Only with it.",
    )
    force: Flag = Field(
        default=False,
        description="Make the result of `make_live` live whatever its recall, and if that cannot be"
        " measured. Only with it.",
    )

    _integers = field_validator("ranks", "segment_length", "segments", mode="before")(integers)

    @model_validator(mode="before")
    @classmethod
    def _poses_of_an_earlier_release(cls, given: object) -> object:
        if not isinstance(given, Mapping) or not isinstance(given.get("poses"), str):
            return given
        meant = _OF_POSES.get(given["poses"], ())
        if not meant or given.get("align", meant[0]) not in meant:
            return given  # and `poses` is rejected
        return {
            "align": meant[0],
            **{name: value for name, value in given.items() if name != "poses"},
        }

    @computed_field(description="`align` as earlier releases had it; it may be sent, too.")  # type: ignore[prop-decorator]
    @property
    def poses(self) -> Literal["checked", "unchecked"]:
        """`align` as earlier releases had it: `unchecked` is `off`."""
        return "unchecked" if self.align == Align.OFF else "checked"

    @model_validator(mode="after")
    def _one_way_to_cut(self) -> "BuildParameters":
        if self.segment_length is not None and self.segments is not None:
            raise ValueError("give segment_length or segments, not both")
        return self

    @model_validator(mode="after")
    def _changes_of_a_base(self) -> "BuildParameters":
        if self.base is None:
            for name in ("add", "remove"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} wants base: the revision that it changes")
            return self
        if self.drives is not None:
            raise ValueError("give drives, or base with add and remove, not both")
        both = sorted(set(self.add or ()) & set(self.remove or ()))
        if both:
            raise ValueError(f"drive {both[0]} is in add and in remove")
        if not (self.add or self.remove or self.max_age_days or self.refit or self.basis):
            raise ValueError(
                "base wants something that changes: add (a drive that it has is read again),"
                " remove, max_age_days, refit, basis"
            )
        return self

    @model_validator(mode="after")
    def _one_basis(self) -> "BuildParameters":
        if self.refit and self.basis is not None:
            raise ValueError("give refit, to fit a basis, or the shared basis to use, not both")
        return self

    @field_validator("drives", "add", "remove")
    @classmethod
    def _each_once(cls, drives: list[str] | None) -> list[str] | None:
        if drives is not None and len(set(drives)) < len(drives):
            raise ValueError("a drive comes twice")
        return drives

    def on_base(self, digest: str, of_base: Mapping[str, Any]) -> "BuildParameters":
        """Return the parameters of a build on that revision: those not given are its own.

        Args:
            digest: The digest of the revision that `base` names.
            of_base: The parameters of its record.

        Raises:
            InvalidParameters: If one is given that differs from that of the revision.
        """
        # Records of releases that knew full views only do not name them.
        taken: dict[str, Any] = {"views": Views.FULL.value, "verification_images": False}
        taken |= {name: value for name, value in of_base.items() if name in _OF_BASE}
        given = self.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        for name in sorted(given.keys() & _OF_BASE):
            if given[name] != taken.get(name):
                raise InvalidParameters(
                    f"{name} is {given[name]}, that of base {digest[:12]} is {taken.get(name)}:"
                    " leave it out, or build without base"
                )
        if self.segments is not None:
            raise InvalidParameters("segments cuts drives anew: build without base")
        return type(self).model_validate({**taken, **given, "base": digest})

    def map_parameters(self) -> MapParameters:
        """Return the parameters that the map stores.

        Raises:
            InvalidParameters: If the sensor is unknown, a rank does not fit its grid or a parameter
                is not one of this encoding.
        """
        return MapParameters.for_sensor(**{name: getattr(self, name) for name in _OF_MAP})

    @property
    def assumptions(self) -> list[str]:
        """A note on each value that is assumed because it was not given."""
        if self.map_parameters().image != ImageKind.HEIGHT:
            return []
        note = sensor_named(self.sensor).height_note(self.sensor_height_m)
        return [] if note is None else [note]

    def resolved(self) -> "BuildParameters":
        """Return them with the defaults of the encoding and sensor filled in.

        Raises:
            InvalidParameters: As in `map_parameters`.
        """
        given = self.model_dump(mode="json", exclude_none=True)
        return type(self).model_validate({**as_built(self.map_parameters()), **given})

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return self.model_dump(mode="json")


def as_built(parameters: MapParameters) -> dict[str, Any]:
    """Return a map's parameters by their names here, as plain values."""
    named: dict[str, Any] = to_jsonable_python({n: getattr(parameters, n) for n in _OF_MAP})
    return named
