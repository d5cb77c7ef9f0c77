"""The most likely place of a belief, and its spread."""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.confidence.places import AWAY_M
from core.mapping.tensormap import TensorMap
from core.scans.angles import wrapped_deg
from core.scans.trajectory import Trajectory
from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.step import SURE, Direction

NEAR_M = 5.0
NEAR_STRIDES = 5
"""The size of a place: metres, or the scans of so many strides in one drive without a pose.

A place reaches to the scans before and after it that are up to `AWAY_M` away: between two scans a
vehicle is as likely near one as near the other.
"""

_WINDOW = 4  # rows to either side of the most likely one that are averaged, or those of its place
_OPPOSITE_DEG = 90.0
_BUMP = 2  # rows to either side over which the probability is summed to find the most likely row


@dataclass(frozen=True, eq=False)
class Place:
    """The part of the map around the most likely row.

    Attributes:
        position: Mean of the belief in `rows`; with stands the row of its mean way.
        sigma: Standard deviation in scans, where a stand counts as one.
        probability: The probability of being near that row.
        along: The probability of passing it in the direction of that row, given that the vehicle is
            there.
        rows: The rows that were averaged: those of the place that follow each other in one drive
            and direction, at least some to either side.
        weight: The belief in each of them, sums to 1.
        steps: How many scans each of them is from the first, where a stand counts as one.
    """

    position: float
    sigma: float
    probability: float
    along: float
    rows: slice
    weight: FloatArray
    steps: IntArray

    def beyond(self, row: int) -> tuple[float, float]:
        """Return the belief in the scans before a row and its stand, and in those after these."""
        at = self.steps - self.steps[row - self.rows.start]
        return float(self.weight[at < 0].sum()), float(self.weight[at > 0].sum())

    @property
    def direction(self) -> Direction | None:
        """The direction in which the vehicle passes the place, `None` while that is uncertain."""
        if self.along >= SURE:
            return Direction.ALONG
        return Direction.AGAINST if self.along <= 1.0 - SURE else None

    def share_between(self, first: float, end: float) -> float:
        """Return the share of its belief between two positions in rows, as those of two cuts.

        Only `rows`, of one drive, count: which of the drives along a street is nearest is no doubt
        about where the vehicle is. A row is the path half-way to its neighbours, and a cut can be
        anywhere on it.
        """
        rows = np.arange(self.rows.start, self.rows.stop)
        within = np.minimum(rows + 0.5, end) - np.maximum(rows - 0.5, first)
        return min(1.0, float(self.weight @ np.maximum(within, 0.0)))

    def sigma_m(self, along_m: FloatArray, row_variance_m2: FloatArray) -> float | None:
        """Return its standard deviation along the path, `None` where metres are unknown.

        Args:
            along_m: `(K,)` metres along the map's drives, as of `TravelGraph`.
            row_variance_m2: `(K,)` the variance within each row, where a vehicle may be anywhere.
        """
        metres = along_m[self.rows]
        if np.isnan(metres).any():
            return None
        variance_m2 = (metres - self.weight @ metres) ** 2 + row_variance_m2[self.rows]
        return float(np.sqrt(self.weight @ variance_m2))

    @classmethod
    def most_likely(cls, belief: Belief, tensor_map: TensorMap, graph: TravelGraph) -> "Place":
        """Return the most likely place of a belief.

        Args:
            belief: The belief.
            tensor_map: The map.
            graph: The map's graph.
        """
        of_scan, stands = belief.of_scan, tensor_map.trajectory.stands
        bump = min(_BUMP, (len(of_scan) - 1) // 2)  # a wider one makes more sums than scans
        sums = np.convolve(of_scan, np.ones(2 * bump + 1), mode="same")
        if len(stood := graph.stood):
            first = stands[stood, 0]
            sums[stood] = np.maximum(sums[stood], np.bincount(first, of_scan[stood])[first])
        row = int(sums.argmax())
        near = np.flatnonzero(_near(tensor_map, graph, row))
        # Of scans far apart one may hold all of it, and the sums beside it are as large.
        low = max(0, row - _BUMP)
        highest = low + int(of_scan[low : row + _BUMP + 1].argmax())
        if highest != row:
            around = np.flatnonzero(_near(tensor_map, graph, highest))
            if of_scan[around].sum() > of_scan[near].sum():
                row, near = highest, around
        # Another drive, or this one on its way back, may have recorded the street in the opposite
        # direction.
        headings_deg = tensor_map.trajectory.headings_deg
        opposite = np.abs(wrapped_deg(headings_deg[near] - headings_deg[row])) > _OPPOSITE_DEG
        rows = _rows_around(tensor_map, row, near[~opposite])
        within = of_scan[rows]
        total = float(within.sum())
        weight = within / total if total > 0.0 else np.full(len(within), 1.0 / len(within))
        first = stands[rows, 0]
        steps = np.concatenate([[0], np.cumsum(first[1:] != first[:-1])])
        mean = float(weight @ steps)
        probability = float(of_scan[near].sum())
        of_along = belief.along(near)
        along = float(np.where(opposite, of_scan[near] - of_along, of_along).sum())
        return cls(
            position=rows.start + _mean_row(weight, steps, graph.along_m[rows]),
            sigma=float(np.sqrt(weight @ (steps - mean) ** 2)),
            probability=min(1.0, probability),
            along=along / probability if probability > 0.0 else 0.5,
            rows=rows,
            weight=weight,
            steps=steps,
        )


def _mean_row(weight: FloatArray, steps: IntArray, along_m: FloatArray) -> float:
    """Return the mean of a belief in rows, from the first: with stands the row of its mean way.

    A stand has hardly any length, whatever the number of its rows.
    """
    rows = np.arange(len(weight))
    if steps[-1] == rows[-1] or np.isnan(along_m).any():
        return float(weight @ rows)
    return float(np.interp(weight @ along_m, along_m, rows))


def _rows_around(tensor_map: TensorMap, row: int, near: IntArray) -> slice:
    """Return the rows around one that follow each other in its drive and are of its place.

    `_WINDOW` to either side are less than a metre where scans are 0.2 m apart, and no way at all
    where the mapping vehicle stood: the spread of the belief would be that of the window.

    Args:
        tensor_map: The map.
        row: The row.
        near: `(n,)` the rows of its place in its direction, rising, it one of them.
    """
    drive = int(tensor_map.trajectory.drive_of_scan[row])
    first, end = tensor_map.trajectory.drive_start[drive : drive + 2].tolist()
    at = int(near.searchsorted(row))
    follows = near - near[at] == np.arange(len(near)) - at
    run = near[follows]
    low, high = min(int(run[0]), row - _WINDOW), max(int(run[-1]), row + _WINDOW)
    return slice(max(first, low), min(end, high + 1))


def _near(tensor_map: TensorMap, graph: TravelGraph, row: int) -> BoolArray:
    trajectory = tensor_map.trajectory
    apart_m = trajectory.apart_m(row)
    is_close: BoolArray = apart_m <= _size_m(trajectory, row, apart_m)
    if trajectory.all_known:
        return is_close
    drive = trajectory.drive_of_scan
    rows = np.arange(len(drive))
    near_scans = NEAR_STRIDES * int(graph.strides.scans[2 * row])
    by_scans: BoolArray = (drive == drive[row]) & (np.abs(rows - row) <= near_scans)
    if not trajectory.known[row]:
        return by_scans
    return np.where(trajectory.known, is_close, by_scans)


def _size_m(trajectory: Trajectory, row: int, apart_m: FloatArray) -> float:
    """Return how far from a scan its place reaches."""
    beside = [max(0, row - 1), min(row + 1, len(apart_m) - 1)]
    of_drive = trajectory.drive_of_scan[beside] == trajectory.drive_of_scan[row]
    reached = of_drive & (apart_m[beside] <= AWAY_M)
    return float(apart_m[beside].max(where=reached, initial=NEAR_M))
