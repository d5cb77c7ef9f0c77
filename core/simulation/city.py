"""A random city: a grid of streets with houses, hedges, trees, poles and cars."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from core.arrays import FloatArray
from core.numbers import require_at_least
from core.simulation.world import Boxes, Cylinders, Traffic, World

# Every stretch of street draws from streams of its own, keyed by these and its place in the grid,
# so that other traffic leaves every house where it was.
_GRID, _LAYOUT, _PARKED, _MOVING = range(4)

_STREET_SPACING_M = (60.0, 78.0)
_LANE_M = 3.0  # from the centre line to the middle of a lane: a vehicle on the line can be passed
_KERB_M = 5.5  # from the centre line to the middle of a parked car: 3 m aside, a vehicle still fits
_TREES_M = 7.4
_FRONT_M = (8.6, 14.0)  # from the centre line to the line of the house fronts, street by street
_CORNER_M = 10.5  # no car parks nearer to a crossing street's centre line: vehicles turn there
_CLOSED_SHARE = 0.7  # of the ends of streets: else all junctions would be alike
_BESIDE_M = 42.0  # no solid of a street reaches farther from its centre line
_PART_M = 32.0  # side of the squares whose surroundings are one part of a city


class _Street(NamedTuple):
    """A street of the grid, along y (axis 0) or x (axis 1).

    Attributes:
        axis: 0 runs north, 1 runs east.
        line: Which of its axis, from west or south.
        at_m: The centre line's x (axis 0) or y (axis 1).
        front_m: The distance from the centre line to the line of the house fronts.
        open_from: The first street across that it reaches; 1 where a house closes its near end.
        open_to: The last street across that it reaches.
    """

    axis: int
    line: int
    at_m: float
    front_m: float
    open_from: int
    open_to: int


class _Stretch(NamedTuple):
    """One side of a street from one crossing to another, seen with the houses to the left.

    A place on it is `along_m` from the middle of the first crossing and `aside_m` left of the
    street's centre line.

    Attributes:
        x_m: The x of the middle of the first crossing.
        y_m: The y of the middle of the first crossing.
        heading_deg: Along it.
        length_m: The distance from crossing to crossing.
        front_m: The distance from the centre line to the line of the house fronts.
        begin_m: Position of that line of the first street crossed.
        end_m: Position of that line of the second.
        key: The key of its random streams.
    """

    x_m: float
    y_m: float
    heading_deg: float
    length_m: float
    front_m: float
    begin_m: float
    end_m: float
    key: tuple[int, ...]

    def place(self, along_m: float, aside_m: float) -> tuple[float, float]:
        """Return x and y in metres."""
        cos, sin = np.cos(np.radians(self.heading_deg)), np.sin(np.radians(self.heading_deg))
        return (self.x_m + along_m * cos - aside_m * sin, self.y_m + along_m * sin + aside_m * cos)


class _Solids(NamedTuple):
    """What stands along one side of a stretch, a row a solid."""

    boxes: FloatArray
    cylinders: FloatArray
    parked: FloatArray


@dataclass(frozen=True)
class City:
    """A random city, made part by part where it is needed; equal arguments give equal cities.

    Attributes:
        seed: The seed of streets, houses, hedges, trees and poles.
        traffic_seed: The seed of parked and moving cars. Another one is the same city on another
            day.
        blocks: How many blocks east and north.

    Raises:
        InvalidParameters: If a seed is negative or there is no block.

    Examples:
        >>> large = City(1, 1, (2000, 2000))
        >>> 100 < len(large.around(5000.0, 5000.0, 100.0).buildings) < 2000
        True
        >>> monday, tuesday = City(1, 1).whole(), City(1, 2).whole()
        >>> bool((monday.buildings.rows == tuesday.buildings.rows).all())
        True
        >>> monday.parked.rows[0].tolist() == tuesday.parked.rows[0].tolist()
        False
    """

    seed: int
    traffic_seed: int
    blocks: tuple[int, int] = (3, 3)

    def __post_init__(self) -> None:
        require_at_least(0, seed=self.seed, traffic_seed=self.traffic_seed)
        require_at_least(1, blocks=min(self.blocks))

    @cached_property
    def _north(self) -> list[_Street]:
        return _streets(self.seed, 0, self.blocks)

    @cached_property
    def _east(self) -> list[_Street]:
        return _streets(self.seed, 1, self.blocks)

    @property
    def street_x_m(self) -> tuple[float, ...]:
        """Centre lines of the streets that run north, ascending."""
        return tuple(street.at_m for street in self._north)

    @property
    def street_y_m(self) -> tuple[float, ...]:
        """Centre lines of the streets that run east, ascending."""
        return tuple(street.at_m for street in self._east)

    def whole(self) -> World:
        """Return all of the city."""
        return self.part((-math.inf, math.inf), (-math.inf, math.inf))

    def around(self, x_m: float, y_m: float, within_m: float) -> World:
        """Return what is within some metres of a place at any time, and more."""
        return _part_around(self, math.floor(x_m / _PART_M), math.floor(y_m / _PART_M), within_m)

    def part(self, x_m: tuple[float, float], y_m: tuple[float, float]) -> World:
        """Return what stands or drives along the streets that reach into a rectangle.

        Args:
            x_m: From the least to the largest x.
            y_m: The same of y.
        """
        solids: list[_Solids] = []
        moving: list[FloatArray] = []
        for streets, across, beside_m, along_m in (
            (self._north, self._east, x_m, y_m),
            (self._east, self._north, y_m, x_m),
        ):
            for street in streets:
                if not beside_m[0] <= street.at_m <= beside_m[1]:
                    continue
                for first, last in pairwise(across):
                    if first.at_m <= along_m[1] and along_m[0] <= last.at_m:
                        is_open = street.open_from <= first.line and last.line <= street.open_to
                        solids += [
                            _solids(self.seed, self.traffic_seed, stretch, is_open=is_open)
                            for stretch in _sides(street, first, last)
                        ]
                lanes = _sides(street, across[street.open_from], across[street.open_to])
                moving += [_moving(self.traffic_seed, lane) for lane in lanes]
        return World(
            Boxes(_joined([of.boxes for of in solids], 7)),
            Cylinders(_joined([of.cylinders for of in solids], 5)),
            Boxes(_joined([of.parked for of in solids], 7)),
            Traffic(_joined(moving, 9)),
        )


@lru_cache(maxsize=16)  # a vehicle is in one square for several scans
def _part_around(city: City, column: int, row: int, within_m: float) -> World:
    x_m, y_m = (
        (at * _PART_M - within_m - _BESIDE_M, (at + 1) * _PART_M + within_m + _BESIDE_M)
        for at in (column, row)
    )
    return city.part(x_m, y_m)


def _joined(rows: list[FloatArray], columns: int) -> FloatArray:
    return np.concatenate([np.empty((0, columns)), *rows])


@lru_cache(maxsize=2048)  # the surroundings of a few squares
def _solids(seed: int, traffic_seed: int, stretch: _Stretch, *, is_open: bool) -> _Solids:
    rng = np.random.default_rng([seed, _LAYOUT, *stretch.key])
    boxes = [*_houses(stretch, rng)]
    cylinders: list[tuple[float, ...]] = []
    parked: list[tuple[float, ...]] = []
    if is_open:
        boxes += _furniture(stretch, rng)
        cylinders += [*_trees(stretch, rng), *_poles(stretch, rng)]
        rng = np.random.default_rng([traffic_seed, _PARKED, *stretch.key])
        parked += _parked(stretch, rng)
    else:
        boxes += _mouth(stretch, rng)
    return _Solids(_rows(boxes, 7), _rows(cylinders, 5), _rows(parked, 7))


def _rows(solids: list[tuple[float, ...]], columns: int) -> FloatArray:
    return np.array(solids, dtype=np.float64).reshape(-1, columns)


def _streets(seed: int, axis: int, blocks: tuple[int, int]) -> list[_Street]:
    rng = np.random.default_rng([seed, _GRID, axis])
    count, across = blocks[axis] + 1, blocks[1 - axis] + 1
    at_m = np.concatenate([[0.0], np.cumsum(rng.uniform(*_STREET_SPACING_M, count - 1))])
    front_m = rng.uniform(*_FRONT_M, count)
    # One end at least: two crossings open on all sides are hard to distinguish, even for humans.
    closed = rng.random((count, 2)) < _CLOSED_SHARE
    closed[~closed.any(axis=1), 0] = True
    closed &= across >= 4  # with fewer streets across, nothing would be left between the ends
    return [
        _Street(
            axis,
            line,
            float(at_m[line]),
            float(front_m[line]),
            int(closed[line, 0]),
            across - 1 - int(closed[line, 1]),
        )
        for line in range(count)
    ]


def _sides(street: _Street, first: _Street, last: _Street) -> Iterator[_Stretch]:
    """Yield the two sides of `street` between two streets across, each with houses to the left."""
    length_m = last.at_m - first.at_m
    for begin, end, turned in ((first, last, 0), (last, first, 1)):
        x, y = (street.at_m, begin.at_m) if street.axis == 0 else (begin.at_m, street.at_m)
        yield _Stretch(
            x,
            y,
            (90.0 if street.axis == 0 else 0.0) + 180.0 * turned,
            length_m,
            street.front_m,
            begin.front_m,
            length_m - end.front_m,
            (street.axis, street.line, min(first.line, last.line), turned),
        )


def _houses(stretch: _Stretch, rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    """Yield houses, and a hedge or wall in front of some that are set back."""
    usual_setback_m = rng.uniform(0.0, 4.0)
    usual_height_m = rng.uniform(4.0, 14.0)
    begin_m = stretch.begin_m + rng.uniform(0.0, 12.0)
    while stretch.end_m - begin_m > 5.0:
        front_m = min(rng.uniform(6.0, 20.0), stretch.end_m - begin_m)
        setback_m = max(0.0, usual_setback_m + rng.uniform(-2.5, 4.0))
        depth_m = rng.uniform(8.0, 14.0)
        height_m = max(3.0, usual_height_m + rng.uniform(-3.0, 4.0))
        middle_m = begin_m + front_m / 2.0
        x, y = stretch.place(middle_m, stretch.front_m + setback_m + depth_m / 2.0)
        yield (x, y, stretch.heading_deg, front_m, depth_m, 0.0, height_m)
        if setback_m > 1.5 and rng.random() < 0.5:
            x, y = stretch.place(middle_m + rng.uniform(-1.0, 1.0), stretch.front_m)
            hedge_m, thick_m = front_m * rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.8)
            yield (x, y, stretch.heading_deg, hedge_m, thick_m, 0.0, rng.uniform(0.6, 2.0))
        begin_m += front_m + (0.0 if rng.random() < 0.3 else rng.uniform(1.5, 10.0))


def _mouth(stretch: _Stretch, rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    """Yield half a house across each end of a street that is closed."""
    for front_m, inward in ((stretch.begin_m, 1.0), (stretch.end_m, -1.0)):
        depth_m = rng.uniform(8.0, 12.0)
        setback_m, height_m = rng.uniform(0.0, 6.0), rng.uniform(4.0, 14.0)
        x, y = stretch.place(front_m + inward * (setback_m + depth_m / 2.0), stretch.front_m / 2.0)
        yield (x, y, stretch.heading_deg, depth_m, stretch.front_m, 0.0, height_m)


def _furniture(stretch: _Stretch, rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    """Yield kiosks, shelters and switch boxes near a street's ends: junctions differ by them."""
    for corner_m, inward in ((stretch.begin_m, 1.0), (stretch.end_m, -1.0)):
        for _ in range(rng.integers(0, 4)):
            along_m = corner_m + inward * rng.uniform(1.0, 6.0)
            x, y = stretch.place(along_m, rng.uniform(7.5, stretch.front_m))
            length_m, width_m, top_m = rng.uniform([0.6, 0.4, 1.0], [3.5, 1.5, 2.8]).tolist()
            yield (x, y, stretch.heading_deg, length_m, width_m, 0.0, top_m)


def _trees(stretch: _Stretch, rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    """Yield a trunk and a crown per tree; some streets have few."""
    usual_gap_m = rng.uniform(6.0, 30.0)
    usual_aside_m = rng.uniform(_TREES_M, stretch.front_m - 1.0)
    along_m = stretch.begin_m + rng.uniform(0.0, usual_gap_m)
    while along_m < stretch.end_m:
        x, y = stretch.place(along_m, usual_aside_m + rng.uniform(-0.3, 0.5))
        crown_m, top_m = rng.uniform(1.9, 3.2), rng.uniform(4.5, 9.0)
        yield (x, y, rng.uniform(0.12, 0.35), 0.0, crown_m)
        yield (x, y, rng.uniform(0.8, 2.2), crown_m, top_m)
        along_m += usual_gap_m * rng.uniform(0.5, 1.5)


def _poles(stretch: _Stretch, rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    along_m = stretch.begin_m + rng.uniform(0.0, 20.0)
    while along_m < stretch.end_m:
        x, y = stretch.place(along_m, _TREES_M - 0.6)
        yield (x, y, rng.uniform(0.06, 0.15), 0.0, rng.uniform(2.5, 8.0))
        along_m += rng.uniform(12.0, 32.0)


def _car_m(rng: np.random.Generator) -> tuple[float, float, float]:
    """Return length, width and height of a car, or of one van in eight."""
    if rng.random() < 1 / 8:
        return rng.uniform(4.9, 6.0), rng.uniform(1.9, 2.05), rng.uniform(1.9, 2.6)
    return rng.uniform(3.7, 4.9), rng.uniform(1.65, 1.9), rng.uniform(1.4, 1.7)


def _parked(stretch: _Stretch, rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    taken = rng.uniform(0.2, 0.8)
    along_m = _CORNER_M + rng.uniform(0.0, 4.0)
    while True:
        length_m, width_m, height_m = _car_m(rng)
        if along_m + length_m > stretch.length_m - _CORNER_M:
            return
        if rng.random() < taken:
            x, y = stretch.place(along_m + length_m / 2.0, _KERB_M + rng.uniform(-0.1, 0.2))
            yaw_deg = stretch.heading_deg + rng.uniform(-2.0, 2.0)
            yield (x, y, yaw_deg, length_m, width_m, 0.0, height_m)
        along_m += length_m + rng.uniform(0.6, 1.8)


@lru_cache(maxsize=256)  # a lane is as long as its street
def _moving(traffic_seed: int, lane: _Stretch) -> FloatArray:
    """Return the cars of a lane, on the right of the centre line as they drive."""
    rng = np.random.default_rng([traffic_seed, _MOVING, *lane.key])
    x, y = lane.place(0.0, -_LANE_M)
    # One speed a lane, so that no car drives through the one before it.
    speed_m_s = rng.uniform(6.0, 14.0)
    along_m = rng.uniform(0.0, 80.0)
    cars: list[tuple[float, ...]] = []
    while along_m < lane.length_m - 8.0:
        cars.append((x, y, lane.heading_deg, lane.length_m, along_m, speed_m_s, *_car_m(rng)))
        along_m += rng.uniform(25.0, 130.0)
    return _rows(cars, 9)
