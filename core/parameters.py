"""The choices a map is built with, kept in the map."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from core.errors import InvalidMap, InvalidParameters
from core.projection.imager import Grid, ImageKind, Imager, grid_from_attributes
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.sensor import HDL_64E, AngularGrid, sensor_named
from core.text import flaw_in

__all__ = [
    "DEFAULT_ENCODING",
    "HDL_64E_ON_KITTI_HEIGHT_M",
    "LATERAL_RENDERINGS_M",
    "Distance",
    "Encoding",
    "MapParameters",
    "Segmentation",
    "encoding_with",
]

HDL_64E_ON_KITTI_HEIGHT_M = 1.73  # KITTI's sensor set-up: above ground
_LONGEST_SENSOR = 64
LATERAL_RENDERINGS_M = (-3.0, -1.5, 0.0, 1.5, 3.0)
"""A lane to either side: docs/decisions/0010-harmonic-encoding.md."""


class Encoding(StrEnum):
    """How images become signatures."""

    PAPER = "paper"
    HARMONIC = "harmonic"


DEFAULT_ENCODING = Encoding.HARMONIC
"""Of what is built without saying: docs/decisions/0010-harmonic-encoding.md."""

_OF_THE_PAPER = {Reducer.LAST, Reducer.NEAREST, Reducer.FARTHEST}


def encoding_with(reducer: Reducer | None) -> Encoding:
    """Return the default encoding, or the paper's if only that has such a reducer.

    Examples:
        >>> encoding_with(None).value, encoding_with(Reducer.LAST).value
        ('harmonic', 'paper')
    """
    return Encoding.PAPER if reducer in _OF_THE_PAPER else DEFAULT_ENCODING


class Segmentation(StrEnum):
    """How drives are cut into segments.

    The paper's are of one length. It asks for unequal ones as its future work, so they are kept,
    though no default chooses them: docs/decisions/0013-unequal-segments-and-topology.md.
    """

    FIXED = "fixed"
    UNEQUAL = "unequal"


class Distance(StrEnum):
    """How far apart two harmonic signatures g and G are, `max` their best correlation.

    `plain` is |g|^2 + |G|^2 - 2 max, `normalised` 1 - max / (|g| |G|).
    """

    PLAIN = "plain"
    NORMALISED = "normalised"


@dataclass(frozen=True)
class MapParameters:
    """What a query must share with the map to be answered by it; by default as in the paper.

    Attributes:
        encoding: How images become signatures.
        ranks: `(r1, r2)`, the shape of a signature; the paper's 5 x 5.
        reducer: Which return a shared cell keeps.
        sensor: Name of the sensor that recorded the drives.
        grid: The lattice of images: the sensor's own, or rings.
        sensor_height_m: Height of the sensor above ground.
        distance: How harmonic signatures are compared, `None` in the paper's encoding.
        lateral_renderings_m: From where, metres to the left, a harmonic map's scans are also
            rendered; `None` in the paper's encoding.
        segmentation: How drives were cut into segments. Queries do not depend on it.
    """

    encoding: Encoding = Encoding.PAPER
    ranks: tuple[int, int] = (5, 5)
    reducer: Reducer = Reducer.LAST
    sensor: str = HDL_64E.name
    grid: Grid = field(default_factory=lambda: HDL_64E.grid)
    sensor_height_m: float = HDL_64E_ON_KITTI_HEIGHT_M
    distance: Distance | None = None
    lateral_renderings_m: tuple[float, ...] | None = None
    segmentation: Segmentation = Segmentation.FIXED

    def __post_init__(self) -> None:
        # 2 and 2.0 metres are one choice, and must be one digest; a list of ranks is no tuple.
        object.__setattr__(self, "encoding", Encoding(self.encoding))
        object.__setattr__(self, "ranks", tuple(map(operator.index, self.ranks)))
        object.__setattr__(self, "reducer", Reducer(self.reducer))
        object.__setattr__(self, "segmentation", Segmentation(self.segmentation))
        object.__setattr__(self, "sensor_height_m", float(self.sensor_height_m))
        flaw = flaw_in(self.sensor, _LONGEST_SENSOR)
        if flaw is not None:
            raise InvalidParameters(f"sensor is {ascii(self.sensor)[:80]}: {flaw}")
        if len(self.ranks) != 2:
            raise InvalidParameters(f"ranks is {self.ranks}, wanted (r1, r2)")
        rows, columns = self.grid.shape
        if self.encoding == Encoding.HARMONIC:
            self._require_harmonic()
            columns = columns // 2 + 1
        else:
            self._require_paper()
        for rank, size, name in zip(self.ranks, (rows, columns), ("r1", "r2"), strict=True):
            if not 1 <= rank <= size:
                raise InvalidParameters(f"{name} is {rank}, wanted 1..{size} on this grid")
        if not 0.0 < self.sensor_height_m < 100.0:
            raise InvalidParameters(
                f"sensor_height_m is {self.sensor_height_m}, wanted above 0 and below 100"
            )

    def _require_harmonic(self) -> None:
        if not self.grid.wraps:
            raise InvalidParameters("a harmonic map's grid wraps: a turn must not have a seam")
        if self.distance is None or self.lateral_renderings_m is None:
            raise InvalidParameters("a harmonic map wants distance and lateral_renderings_m")
        object.__setattr__(self, "distance", Distance(self.distance))
        object.__setattr__(self, "lateral_renderings_m", self.imager.lateral_renderings_m)

    def _require_paper(self) -> None:
        if not isinstance(self.grid, AngularGrid):
            raise InvalidParameters("the paper's encoding is of range images, not of height images")
        for name in ("distance", "lateral_renderings_m"):
            if getattr(self, name) is not None:
                raise InvalidParameters(f"{name} is of the harmonic encoding, not of the paper's")
        self.imager  # noqa: B018  # refuses a reducer of other images

    @property
    def imager(self) -> Imager:
        """How scans become images."""
        return Imager(self.grid, self.reducer, self.sensor_height_m, self.lateral_renderings_m)

    @property
    def image(self) -> ImageKind:
        """What kind of image that is."""
        return self.imager.kind

    @classmethod
    def for_sensor(
        cls,
        sensor: str = HDL_64E.name,
        *,
        encoding: Encoding = DEFAULT_ENCODING,
        ranks: tuple[int, int] = (5, 5),
        reducer: Reducer | None = None,
        sensor_height_m: float = HDL_64E_ON_KITTI_HEIGHT_M,
        image: ImageKind | None = None,
        distance: Distance | None = None,
        lateral_renderings_m: Sequence[float] | None = None,
        segmentation: Segmentation = Segmentation.FIXED,
    ) -> "MapParameters":
        """Return parameters for a known sensor; what is not given is the encoding's own default.

        The paper's are range images, `last`; the harmonic's are heights, `highest`, or on request
        ranges, `mean`, `normalised`, and five renderings.

        Raises:
            InvalidParameters: If the sensor is unknown, a value is out of its range or is not one
                of this encoding.
        """
        known = sensor_named(sensor)
        harmonic = encoding == Encoding.HARMONIC
        if image is None:
            image = ImageKind.HEIGHT if harmonic else ImageKind.RANGE
        if reducer is None:
            of_range = Reducer.MEAN if harmonic else Reducer.LAST
            reducer = Reducer.HIGHEST if image == ImageKind.HEIGHT else of_range
        if harmonic and distance is None:
            distance = Distance.NORMALISED
        if harmonic and lateral_renderings_m is None:
            lateral_renderings_m = LATERAL_RENDERINGS_M
        on_sensor = replace(known.grid, wraps=True) if harmonic else known.grid
        return cls(
            encoding,
            ranks,
            reducer,
            known.name,
            RingGrid() if image == ImageKind.HEIGHT else on_sensor,
            sensor_height_m,
            distance,
            None if lateral_renderings_m is None else tuple(lateral_renderings_m),
            segmentation,
        )

    def as_attributes(self) -> dict[str, Any]:
        """Return plain values for a file's attributes; those of a paper map are the paper's."""
        attributes: dict[str, Any] = {
            "encoding": self.encoding.value,
            "ranks": list(self.ranks),
            "reducer": self.reducer.value,
            "sensor": self.sensor,
            "grid": self.grid.as_attributes(),
            "sensor_height_m": self.sensor_height_m,
        }
        if self.distance is not None and self.lateral_renderings_m is not None:
            attributes["image"] = self.image.value
            attributes["distance"] = self.distance.value
            attributes["lateral_renderings_m"] = list(self.lateral_renderings_m)
        if self.segmentation != Segmentation.FIXED:  # which is what files do not name
            attributes["segmentation"] = self.segmentation.value
        return attributes

    @classmethod
    def from_attributes(cls, attributes: dict[str, Any]) -> "MapParameters":
        """Read what `as_attributes` gave.

        Raises:
            InvalidMap: If something is missing or not of its kind.
        """
        try:
            encoding = Encoding(attributes["encoding"])
            of_harmonic: dict[str, Any] = {}
            if encoding == Encoding.HARMONIC:
                of_harmonic = {
                    "distance": Distance(attributes["distance"]),
                    "lateral_renderings_m": tuple(map(float, attributes["lateral_renderings_m"])),
                }
            return cls(
                encoding,
                attributes["ranks"],
                Reducer(attributes["reducer"]),
                str(attributes["sensor"]),
                grid_from_attributes(attributes["grid"]),
                float(attributes["sensor_height_m"]),
                **of_harmonic,
                segmentation=Segmentation(attributes.get("segmentation", Segmentation.FIXED)),
            )
        except (KeyError, TypeError, ValueError, OverflowError, InvalidParameters) as error:
            raise InvalidMap(f"the map's parameters cannot be read: {error!r}") from error
