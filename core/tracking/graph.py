"""The travel graph: the scans that follow each scan of a map, in either direction."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray
from core.errors import InvalidParameters
from core.mapping.tensormap import TensorMap
from core.scans.path import usual_step_m
from core.scans.stands import cuts_outside
from core.scans.trajectory import Trajectory
from core.tracking.strides import Strides
from core.tracking.walks import Walks

# Of scans without a pose between two that have one: on a curve of 10 m radius the chord across is
# 1.5 % shorter.
_GAP_SCANS = 5
_GAP_M = 6.0
_DIRECTION_M = 2.0  # of the way that shows the direction of travel: far more than poses jitter


@dataclass(frozen=True, eq=False)
class TravelGraph:
    """The map's scans as places, each in two directions.

    Place `2 row` is scan `row` passed along its segment, `2 row + 1` the same scan passed against
    it. A segment's end leads to every other segment at that node, along it if it begins there and
    against it if it ends there; where there is no other, a vehicle stays. All scans of a stand are
    of one place: from each of them one step leads out of it.

    Attributes:
        stood: Rows of the scans in stands, rising.
        cut_position: `(L + 1,)` where segments begin and the last one ends, in fractions of rows;
            a cut within a stand is at its beginning: all of a stand is in one segment.
        segment_ends: `(L, 2)` rows at which each segment begins and ends: where the next one of its
            drive begins, or at the drive's last scan.
        strides: Where each place leads.
        along_m: `(K,)` metres along the map's drives, without unknown steps and those between two
            drives; NaN at scans whose metres are unknown.

    Up to five scans in a row without a pose, or as many as the drive has in 6 m, are taken to be
    evenly between their neighbours. Before a drive's first pose, after its last one and in longer
    gaps metres are unknown.
    """

    stood: IntArray
    cut_position: FloatArray
    segment_ends: IntArray
    strides: Strides
    along_m: FloatArray

    def __len__(self) -> int:
        return len(self.along_m)

    @property
    def places(self) -> int:
        """2K, the number of places."""
        return 2 * len(self)

    @cached_property
    def has_lengths(self) -> bool:
        """Whether there is a scan whose metres are known."""
        return not np.isnan(self.along_m).all()

    @cached_property
    def walks(self) -> Walks:
        """Where each place leads."""
        return Walks(self)

    def prepare(self) -> None:
        """Compute what a prediction may need: the next observation does not wait for it."""
        _ = self.walks.length_m

    def segment_at(self, position: float) -> int:
        """Return the segment of a position in rows, which may be between scans."""
        last = len(self.cut_position) - 2
        return min(max(int(self.cut_position.searchsorted(position, "right")) - 1, 0), last)

    def fraction_at(self, segment: int, position: float) -> float:
        """Return how far along a segment a position in rows is, 0 at its start and 1 at its end."""
        begin, end = self.segment_ends[segment].tolist()
        return float(min(max((position - begin) / max(1, end - begin), 0.0), 1.0))

    @classmethod
    def of_map(cls, tensor_map: TensorMap, cut_position: FloatArray | None = None) -> "TravelGraph":
        """Return the graph of a map.

        Args:
            tensor_map: The map.
            cut_position: `(L + 1,)` where its segments were cut; by default half-way between a
                segment's last scan and the next one's first.

        Raises:
            InvalidParameters: If a cut is not between the scans of its segments.
        """
        starts = tensor_map.model.segment_start
        cuts: FloatArray = np.asarray(starts - 0.5 if cut_position is None else cut_position)
        if cuts.shape != starts.shape or (cuts > starts).any() or (cuts < starts - 1).any():
            raise InvalidParameters(
                "each cut must be between the last scan before it and the first one after it"
            )
        from scipy.sparse import csr_array  # only tracks need it: decision 33

        stands = tensor_map.trajectory.stands
        places = 2 * len(tensor_map)
        one, two = _links(tensor_map, stands).T
        share = 1.0 / np.bincount(one, minlength=places)[one]
        positions_m = _positions_m(tensor_map.trajectory)
        steps_m = _steps_m(positions_m, stands)
        steps_m[tensor_map.trajectory.drive_start[1:-1] - 1] = 0.0
        length_m = _link_lengths_m(tensor_map.trajectory, positions_m, one, two)
        along_m = np.concatenate([[0.0], np.nancumsum(steps_m)])
        along_m[np.isnan(positions_m[:, 0])] = np.nan
        ahead = csr_array((share, (two, one)), shape=(places, places))
        step_m = np.bincount(one, share * length_m, places).astype(np.float64)
        return cls(
            np.flatnonzero(stands[:, 0] < stands[:, 1]),
            cuts_outside(stands, cuts),
            tensor_map.segment_ends,
            Strides.of_scans(ahead, step_m, np.repeat(tensor_map.trajectory.drive_of_scan, 2)),
            along_m,
        )


def _positions_m(trajectory: Trajectory) -> FloatArray:
    """Return where each scan is, `(K, 3)`, with short gaps filled; NaN where unknown."""
    positions_m = trajectory.poses[:, :3].copy()
    known = np.flatnonzero(trajectory.known)
    steps, drive = np.diff(known), trajectory.drive_of_scan[known]
    is_way = np.diff(drive) == 0
    each_m = np.linalg.norm(np.diff(positions_m[known], axis=0), axis=1) / steps
    gap_m = np.full(len(steps), np.inf)
    for one in np.unique(drive[1:][is_way & (steps > 1)]).tolist():
        of_drive = is_way & (drive[1:] == one)
        gap_m[of_drive] = steps[of_drive] * usual_step_m(each_m[of_drive])
    filled = is_way & (steps > 1) & ((steps <= _GAP_SCANS + 1) | (gap_m <= _GAP_M))
    for before, after in np.stack([known[:-1], known[1:]], 1)[filled].tolist():
        between = np.linspace(positions_m[before], positions_m[after], after - before + 1)
        positions_m[before + 1 : after] = between[1:-1]
    return positions_m


def _steps_m(positions_m: FloatArray, stands: IntArray) -> FloatArray:
    """Return the metres from each scan to the next, `(K - 1,)`; a stand is straight.

    By its poses, which jitter, a vehicle that stood for a minute drove 20 m.
    """
    steps_m: FloatArray = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    first, last = stands[:-1].T
    within = np.flatnonzero(np.arange(len(first)) < last)
    first, last = first[within], last[within]
    apart_m = np.linalg.norm(positions_m[last] - positions_m[first], axis=1)
    steps_m[within] = apart_m / (last - first)
    return steps_m


def _link_lengths_m(
    trajectory: Trajectory, positions_m: FloatArray, one: IntArray, two: IntArray
) -> FloatArray:
    """Return the metres of the links from some places to others, `(n,)`; NaN where unknown.

    A link that does not follow its drive may lead to another lane: 6 m sideways are no way driven.
    So what counts is its part ahead, in the mean direction of travel of the two drives there. Where
    these are more than 120 degrees apart less of it counts: the mean direction is hardly known.

    Args:
        trajectory: The map's.
        positions_m: `(K, 3)` of its scans.
        one: `(n,)` the places where the links begin.
        two: `(n,)` the places where they end.
    """
    drive, (first, last) = trajectory.drive_of_scan, trajectory.stands.T
    row, to = one // 2, two // 2
    way_m = positions_m[to] - positions_m[row]
    length_m: FloatArray = np.linalg.norm(way_m, axis=1)
    length_m[one == two] = 0.0
    following = np.where(one % 2 == 0, last[row] + 1, first[row] - 1)
    is_joint = (to != following) | (drive[to] != drive[row]) | (one % 2 != two % 2)
    joints = np.flatnonzero(is_joint & (one != two))
    before = -_directions(trajectory, positions_m, one[joints] ^ 1)
    after = _directions(trajectory, positions_m, two[joints])
    unknown = np.isnan(before[:, 0]) & np.isnan(after[:, 0])
    ahead = np.nan_to_num(before) + np.nan_to_num(after)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1.0)
    ahead_m = np.maximum((way_m[joints] * ahead).sum(axis=1), 0.0)
    length_m[joints] = np.where(unknown, length_m[joints], ahead_m)
    return length_m


def _directions(trajectory: Trajectory, positions_m: FloatArray, places: IntArray) -> FloatArray:
    """Return in which direction each place is left along its drive, `(n, 3)`, NaN where unknown.

    By positions: the x axis of a sensor need not be that of its vehicle.
    """
    rows, is_back, drive = places // 2, places % 2 == 1, trajectory.drive_of_scan
    first, last = trajectory.stands.T
    far = rows.copy()
    while True:
        way_m = positions_m[far] - positions_m[rows]
        length_m = np.linalg.norm(way_m, axis=1, keepdims=True)
        # Past the whole of a stand at once: it may have thousands of scans.
        following = np.where(is_back, first[far] - 1, last[far] + 1).clip(0, len(drive) - 1)
        goes_on = (length_m[:, 0] < _DIRECTION_M) & (drive[following] == drive[rows])
        goes_on &= (following != far) & ~np.isnan(positions_m[following, 0])
        if not goes_on.any():
            unknown = np.full_like(way_m, np.nan)
            return np.asarray(np.divide(way_m, length_m, out=unknown, where=length_m > 0.0))
        far = np.where(goes_on, following, far)


def _links(tensor_map: TensorMap, stands: IntArray) -> NDArray[np.int64]:
    """Return all pairs of a place and one that is a step ahead, `(n, 2)`; each place has one.

    A step leads out of a stand: past its last scan, or into a segment that is met within it.
    """
    starts = tensor_map.model.segment_start
    rows, (first, last) = np.arange(len(tensor_map)), stands.T
    begins, ends = np.zeros((2, len(rows)), bool)
    begins[starts[:-1]] = ends[starts[1:] - 1] = True
    links = [
        np.stack([2 * rows, 2 * last + 2], 1)[~ends[last]],
        np.stack([2 * rows + 1, 2 * first - 1], 1)[~begins[first]],
    ]
    # The places where each segment is left: against it, and along it.
    exits = np.stack([2 * starts[:-1] + 1, 2 * starts[1:] - 2], axis=1).tolist()
    joints: list[tuple[int, int]] = []
    for segment in range(len(exits)):
        for forward in (True, False):
            leaving = exits[segment][forward]
            entered = [
                # The place where a segment is entered is its end in the other direction, reversed.
                exits[entry.segment][not entry.forward] ^ 1
                for entry in tensor_map.topology.neighbours(segment, forward=forward)
            ]
            row = leaving // 2
            low, high = stands[row].tolist()
            if low < high:
                entered = [place for place in entered if not low <= place // 2 <= high]
            if not entered and row == (high if forward else low):
                entered = [leaving]
            begun = range(low, row + 1) if forward else range(row, high + 1)
            joints += [(2 * start + (not forward), place) for start in begun for place in entered]
    return np.concatenate([*links, np.array(joints, dtype=np.int64).reshape(-1, 2)])
