"""The choices a map is built with, kept in the map."""

import operator
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from core.errors import InvalidMap, InvalidParameters
from core.projection import Reducer
from core.sensor import HDL_64E, AngularGrid, sensor_named

__all__ = ["Encoding", "MapParameters"]

HDL_64E_ON_KITTI_HEIGHT_M = 1.73  # KITTI's sensor set-up: above ground


class Encoding(StrEnum):
    """How images become signatures."""

    PAPER = "paper"


@dataclass(frozen=True)
class MapParameters:
    """What a query must share with the map to be answered by it.

    Attributes:
        encoding: How images become signatures.
        ranks: `(r1, r2)`, the shape of a signature; the paper's 5 x 5.
        reducer: Which return a shared cell keeps.
        sensor: Name of the sensor that recorded the drives.
        grid: Its lattice.
        sensor_height_m: Height of the sensor above ground.
    """

    encoding: Encoding = Encoding.PAPER
    ranks: tuple[int, int] = (5, 5)
    reducer: Reducer = Reducer.LAST
    sensor: str = HDL_64E.name
    grid: AngularGrid = field(default_factory=lambda: HDL_64E.grid)
    sensor_height_m: float = HDL_64E_ON_KITTI_HEIGHT_M

    def __post_init__(self) -> None:
        # 2 and 2.0 metres are one choice, and must be one digest; a list of ranks is no tuple.
        object.__setattr__(self, "encoding", Encoding(self.encoding))
        object.__setattr__(self, "ranks", tuple(map(operator.index, self.ranks)))
        object.__setattr__(self, "reducer", Reducer(self.reducer))
        object.__setattr__(self, "sensor_height_m", float(self.sensor_height_m))
        if len(self.ranks) != 2:
            raise InvalidParameters(f"ranks is {self.ranks}, wanted (r1, r2)")
        for rank, size, name in zip(self.ranks, self.grid.shape, ("r1", "r2"), strict=True):
            if not 1 <= rank <= size:
                raise InvalidParameters(f"{name} is {rank}, wanted 1..{size} on this grid")
        if not 0.0 < self.sensor_height_m < 100.0:
            raise InvalidParameters(
                f"sensor_height_m is {self.sensor_height_m}, wanted above 0 and below 100"
            )

    @classmethod
    def for_sensor(
        cls,
        sensor: str = HDL_64E.name,
        *,
        encoding: Encoding = Encoding.PAPER,
        ranks: tuple[int, int] = (5, 5),
        reducer: Reducer = Reducer.LAST,
        sensor_height_m: float = HDL_64E_ON_KITTI_HEIGHT_M,
    ) -> "MapParameters":
        """Return parameters on a known sensor's own grid.

        Raises:
            InvalidParameters: If the sensor is unknown or a value is out of its range.
        """
        known = sensor_named(sensor)
        return cls(encoding, ranks, reducer, known.name, known.grid, sensor_height_m)

    def as_attributes(self) -> dict[str, Any]:
        """Return plain values for a file's attributes."""
        return {**asdict(self), "ranks": list(self.ranks)}

    @classmethod
    def from_attributes(cls, attributes: dict[str, Any]) -> "MapParameters":
        """Read what `as_attributes` gave.

        Raises:
            InvalidMap: If something is missing or not of its kind.
        """
        try:
            return cls(
                Encoding(attributes["encoding"]),
                attributes["ranks"],
                Reducer(attributes["reducer"]),
                str(attributes["sensor"]),
                AngularGrid(**attributes["grid"]),
                float(attributes["sensor_height_m"]),
            )
        except (KeyError, TypeError, ValueError, OverflowError, InvalidParameters) as error:
            raise InvalidMap(f"the map's parameters cannot be read: {error!r}") from error
