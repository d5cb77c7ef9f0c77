"""The parameters a map is built with, stored in the map."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from core.encodings.distance import Distance
from core.encodings.registry import DEFAULT_ENCODING, encoding_named
from core.errors import InvalidMap, InvalidParameters
from core.projection.imager import Grid, ImageKind, Imager, Views, grid_from_attributes
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.sensor import HDL_64E, HDL_64E_ON_KITTI_HEIGHT_M, sensor_named
from core.text import flaw_in

if TYPE_CHECKING:
    from core.encodings.base import Encoding

_LONGEST_SENSOR = 64


class Segmentation(StrEnum):
    """How drives are cut into segments.

    The paper's have one length. Unequal ones are its future work; they are available, but not the
    default: docs/decisions/0013-unequal-segments-and-topology.md.
    """

    FIXED = "fixed"
    UNEQUAL = "unequal"


@dataclass(frozen=True)
class MapParameters:
    """The parameters that a query must share with the map; by default as in the paper.

    Attributes:
        encoding: How images become signatures: a name that `core.encodings.registry` knows.
        ranks: `(r1, r2)`, the shape of a signature; the paper's 5 x 5.
        reducer: Which return a shared cell keeps.
        sensor: Name of the sensor that recorded the drives.
        grid: The lattice of images: the sensor's own, or rings.
        sensor_height_m: Height of the sensor above ground.
        distance: How signatures are compared, `None` in an encoding of one measure only.
        lateral_renderings_m: The viewpoints, metres to the left, that the map's scans are also
            rendered from; `None` in an encoding without virtual viewpoints.
        segmentation: How drives were cut into segments. Queries do not depend on it.
        views: Which views the map answers; `any` in an encoding that can mask signatures only.
        verification_images: Whether a map of any views keeps small images of its scans, with which
            the best candidates of scan queries are compared.
    """

    encoding: str = "paper"
    ranks: tuple[int, int] = (5, 5)
    reducer: Reducer = Reducer.LAST
    sensor: str = HDL_64E.name
    grid: Grid = field(default_factory=lambda: HDL_64E.grid)
    sensor_height_m: float = HDL_64E_ON_KITTI_HEIGHT_M
    distance: Distance | None = None
    lateral_renderings_m: tuple[float, ...] | None = None
    segmentation: Segmentation = Segmentation.FIXED
    views: Views = Views.FULL
    verification_images: bool = False

    def __post_init__(self) -> None:
        # 2 and 2.0 metres are one choice, and must be one digest; a list of ranks is no tuple.
        object.__setattr__(self, "ranks", _whole_numbers(self.ranks))
        for name, kind in (("reducer", Reducer), ("segmentation", Segmentation), ("views", Views)):
            object.__setattr__(self, name, _choice(kind, name, getattr(self, name)))
        object.__setattr__(self, "sensor_height_m", float(self.sensor_height_m))
        flaw = flaw_in(self.sensor, _LONGEST_SENSOR)
        if flaw is not None:
            raise InvalidParameters(f"sensor is {ascii(self.sensor)[:80]}: {flaw}")
        if not isinstance(self.verification_images, bool):
            raise InvalidParameters(
                f"verification_images is {self.verification_images!r}, wanted true or false"
            )
        if len(self.ranks) != 2:
            raise InvalidParameters(f"ranks is {self.ranks}, wanted (r1, r2)")
        # The imager rejects a reducer of other images, and normalizes renderings.
        object.__setattr__(self, "lateral_renderings_m", self.imager.lateral_renderings_m)
        if self.distance is not None:
            object.__setattr__(self, "distance", _choice(Distance, "distance", self.distance))
        self.encoder.require_parameters(self)
        if not 0.0 < self.sensor_height_m < 100.0:
            raise InvalidParameters(
                f"sensor_height_m is {self.sensor_height_m}, wanted above 0 and below 100"
            )

    @property
    def encoder(self) -> "Encoding":
        """The encoding itself."""
        return encoding_named(self.encoding)

    @property
    def imager(self) -> Imager:
        """How scans become images."""
        return Imager(
            self.grid, self.reducer, self.sensor_height_m, self.lateral_renderings_m, self.views
        )

    @property
    def image(self) -> ImageKind:
        """What kind of image that is."""
        return self.imager.kind

    @classmethod
    def for_sensor(
        cls,
        sensor: str = HDL_64E.name,
        *,
        encoding: str = DEFAULT_ENCODING,
        ranks: tuple[int, int] | None = None,
        reducer: Reducer | None = None,
        sensor_height_m: float | None = None,
        image: ImageKind | None = None,
        distance: Distance | None = None,
        lateral_renderings_m: Sequence[float] | None = None,
        segmentation: Segmentation = Segmentation.FIXED,
        views: Views | None = None,
        verification_images: bool | None = None,
    ) -> "MapParameters":
        """Return parameters for a known sensor; what is not given is the encoding's default.

        The paper's are range images, `last`; the harmonic's are heights, `highest`, or on request
        ranges, `mean`, `normalised`, and five renderings. Maps answer any views where they can, and
        then have verification images. A sensor without a usual height is assumed as high as an
        HDL-64E.

        Raises:
            InvalidParameters: If the sensor or encoding is unknown, a value is out of its range or
                the encoding has no such parameter.
        """
        known, encoder = sensor_named(sensor), encoding_named(encoding)
        kind = next(iter(encoder.reducers)) if image is None else image
        offsets_m = encoder.lateral_renderings_m
        if lateral_renderings_m is not None:
            offsets_m = tuple(lateral_renderings_m)
        measure = encoder.distance if distance is None else distance
        if views is None:
            views = encoder.default_views(kind, measure)
        return cls(
            encoding,
            encoder.default_ranks(views) if ranks is None else ranks,
            encoder.default_reducer(kind) if reducer is None else reducer,
            known.name,
            RingGrid()
            if kind == ImageKind.HEIGHT
            else replace(known.grid, wraps=encoder.wraps or known.grid.wraps),
            known.height_or_assumed_m(sensor_height_m),
            measure,
            offsets_m,
            segmentation,
            views,
            views == Views.ANY if verification_images is None else verification_images,
        )

    def as_attributes(self) -> dict[str, Any]:
        """Return plain values for a file's attributes; those of a paper map are the paper's."""
        attributes: dict[str, Any] = {
            "encoding": self.encoding,
            "ranks": list(self.ranks),
            "reducer": self.reducer.value,
            "sensor": self.sensor,
            "grid": self.grid.as_attributes(),
            "sensor_height_m": self.sensor_height_m,
        }
        if self.distance is not None:
            attributes["image"] = self.image.value
            attributes["distance"] = self.distance.value
        if self.lateral_renderings_m is not None:
            attributes["lateral_renderings_m"] = list(self.lateral_renderings_m)
        if self.segmentation != Segmentation.FIXED:  # which is what files do not name
            attributes["segmentation"] = self.segmentation.value
        if self.views != Views.FULL:
            attributes["views"] = self.views.value
        if self.verification_images:
            attributes["verification_images"] = True
        return attributes

    @classmethod
    def from_attributes(cls, attributes: dict[str, Any]) -> "MapParameters":
        """Return the parameters of attributes that `as_attributes` returned.

        Raises:
            InvalidMap: If an attribute is missing or invalid.
        """
        try:
            distance = attributes.get("distance")
            offsets_m = attributes.get("lateral_renderings_m")
            return cls(
                str(attributes["encoding"]),
                attributes["ranks"],
                Reducer(attributes["reducer"]),
                str(attributes["sensor"]),
                grid_from_attributes(attributes["grid"]),
                float(attributes["sensor_height_m"]),
                distance,
                None if offsets_m is None else tuple(map(float, offsets_m)),
                Segmentation(attributes.get("segmentation", Segmentation.FIXED)),
                Views(attributes.get("views", Views.FULL)),
                attributes.get("verification_images", False),
            )
        except (KeyError, TypeError, ValueError, OverflowError, InvalidParameters) as error:
            raise InvalidMap(f"the map's parameters cannot be read: {error!r}") from error


def _whole_numbers(ranks: Sequence[int]) -> tuple[int, ...]:
    try:
        return tuple(map(operator.index, ranks))
    except TypeError:
        raise InvalidParameters(f"ranks is {ranks!r:.80}, wanted (r1, r2), whole numbers") from None


def _choice(kind: type[StrEnum], name: str, given: str) -> StrEnum:
    """Return the member that a word names.

    Raises:
        InvalidParameters: If there is no such member.
    """
    try:
        return kind(given)
    except ValueError:
        wanted = ", ".join(kind)
        raise InvalidParameters(f"{name} is {given!r:.80}, wanted one of {wanted}") from None
