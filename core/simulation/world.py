"""The content of a simulated city: upright solids on flat ground, parked and moving cars."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from core.arrays import FloatArray, frozen
from core.errors import InvalidParameters


@dataclass(frozen=True, eq=False, init=False)
class _Solids:
    """Rows of finite numbers, one a solid; its sizes are positive."""

    rows: FloatArray

    _columns: ClassVar[tuple[str, ...]]
    _sizes: ClassVar[tuple[str, ...]]

    def __init__(self, rows: ArrayLike = ()) -> None:
        columns, sizes = self._columns, self._sizes
        array = np.asarray(rows, dtype=np.float64).reshape(-1, len(columns))
        if not np.isfinite(array).all():
            raise InvalidParameters(f"a solid is {', '.join(columns)}, all finite")
        if (array[:, [columns.index(size) for size in sizes]] <= 0.0).any():
            raise InvalidParameters(f"a solid's {', '.join(sizes)} are positive")
        if columns[-2:] == ("bottom_m", "top_m"):
            bottom_m, top_m = array[:, -2:].T
            if (bottom_m < 0.0).any() or (top_m <= bottom_m).any():
                raise InvalidParameters("a solid is above the ground, its top above its bottom")
        object.__setattr__(self, "rows", frozen(array, np.float64))

    def __len__(self) -> int:
        return len(self.rows)


class Boxes(_Solids):
    """Upright boxes: buildings, hedges, cars.

    Attributes:
        rows: `(n, 7)`: centre x and y in metres, yaw of the length in degrees counter-clockwise,
            length, width, height of the bottom and of the top above the ground in metres.

    Examples:
        >>> wall = Boxes([[10.0, 0.0, 90.0, 8.0, 0.5, 0.0, 3.0]])
        >>> wall.distance_m(0.0, 0.0).tolist()
        [9.75]
    """

    _columns = ("x_m", "y_m", "yaw_deg", "length_m", "width_m", "bottom_m", "top_m")
    _sizes = ("length_m", "width_m")

    def distance_m(self, x_m: float, y_m: float) -> FloatArray:
        """Return how far each footprint is from a point, `(n,)` metres, 0 inside."""
        x, y, yaw_deg, length, width = self.rows[:, :5].T
        cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
        along = np.abs((x_m - x) * cos + (y_m - y) * sin) - length / 2.0
        across = np.abs((y_m - y) * cos - (x_m - x) * sin) - width / 2.0
        return np.asarray(np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)))


class Cylinders(_Solids):
    """Upright cylinders: poles, the trunks of trees and their crowns.

    Attributes:
        rows: `(n, 5)`: centre x and y, radius, height of the bottom and of the top above the
            ground, all in metres.
    """

    _columns = ("x_m", "y_m", "radius_m", "bottom_m", "top_m")
    _sizes = ("radius_m",)


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a ray can hit at one moment; the ground is z = 0 everywhere."""

    boxes: Boxes = field(default_factory=Boxes)
    cylinders: Cylinders = field(default_factory=Cylinders)


class Traffic(_Solids):
    """Cars that drive along straight lanes at a constant speed.

    At the end of its lane a car begins again at the start.

    Attributes:
        rows: `(n, 9)`: x and y of the lane's start in metres, heading in degrees, length of the
            lane and distance along it at time 0 in metres, speed in metres per second, length,
            width and height of the car in metres.

    Examples:
        >>> one = Traffic([[0.0, 0.0, 90.0, 100.0, 95.0, 10.0, 4.5, 1.8, 1.5]])
        >>> one.at(2.0).rows[0, :2].round(6).tolist()
        [0.0, 15.0]
    """

    _sizes = ("lane_m", "length_m", "width_m", "height_m")
    _columns = ("x_m", "y_m", "heading_deg", "lane_m", "along_m", "speed_m_s", *_sizes[1:])

    def at(self, time_s: float) -> Boxes:
        """Return the cars where they are at `time_s`."""
        x, y, heading_deg, lane, along, speed, length, width, height = self.rows.T
        along = np.mod(along + speed * time_s, lane)
        x = x + along * np.cos(np.radians(heading_deg))
        y = y + along * np.sin(np.radians(heading_deg))
        bottom = np.zeros_like(height)
        return Boxes(np.stack([x, y, heading_deg, length, width, bottom, height], axis=1))


@dataclass(frozen=True, eq=False)
class World:
    """A city.

    Attributes:
        buildings: Houses, and the hedges and walls in front of them.
        poles: Poles, the trunks of trees and their crowns.
        parked: Parked cars.
        moving: Moving cars.
    """

    buildings: Boxes = field(default_factory=Boxes)
    poles: Cylinders = field(default_factory=Cylinders)
    parked: Boxes = field(default_factory=Boxes)
    moving: Traffic = field(default_factory=Traffic)

    def at(
        self, time_s: float, *, around_m: tuple[float, float] | None = None, give_way_m: float = 0.0
    ) -> Scene:
        """Return what a ray can hit at `time_s`.

        Args:
            time_s: Seconds since the drive began.
            around_m: x and y of a vehicle, if any.
            give_way_m: A moving car nearer to that vehicle is left out: simulated cars do not
                brake, and would drive through it.
        """
        moving = self.moving.at(time_s).rows
        if around_m is not None:
            moving = moving[Boxes(moving).distance_m(*around_m) >= give_way_m]
        rows = np.concatenate([self.buildings.rows, self.parked.rows, moving])
        return Scene(Boxes(rows), self.poles)
