"""Where a vehicle can go from each scan of a map, in either direction of travel."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from core.arrays import FloatArray, IntArray
from core.errors import InvalidParameters
from core.mapping.tensormap import TensorMap


@dataclass(frozen=True, eq=False)
class TravelGraph:
    """The map's scans as places to pass, each in two directions.

    Place `2 row` is scan `row` passed along its segment, `2 row + 1` the same scan passed against
    it. A segment's end leads to every other segment that meets there, along it if it begins at the
    node and against it if it ends there; where nothing meets, a vehicle stays.

    Attributes:
        segment_of_scan: `(K,)`.
        cut_position: `(L + 1,)` where segments begin and the last one ends, in rows and between
            them.
        segment_ends: `(L, 2)` rows at which each segment begins and ends: where the next one of its
            drive begins, or at the drive's last scan.
        ahead: `(2K, 2K)`, the share of what is at a place (column) that is at another (row) one
            scan further on; columns sum to 1.
        step_m: `(2K,)` metres to the next scan ahead, NaN where unknown, 0 where nothing is ahead.
        along_m: `(K,)` metres along the map's drives, without a jump between them; NaN unknown.
    """

    segment_of_scan: IntArray
    cut_position: FloatArray
    segment_ends: IntArray
    ahead: "csr_array[np.float64, tuple[int, int]]"
    step_m: FloatArray
    along_m: FloatArray

    def __len__(self) -> int:
        return len(self.segment_of_scan)

    @property
    def places(self) -> int:
        """2K, how many places there are."""
        return 2 * len(self)

    @cached_property
    def reverse(self) -> IntArray:
        """The place of the same scan in the other direction, `(2K,)`."""
        return np.arange(self.places) ^ 1

    def segment_at(self, position: float) -> int:
        """Return the segment of a position in rows, between scans too."""
        last = len(self.cut_position) - 2
        return int(np.clip(np.searchsorted(self.cut_position, position, "right") - 1, 0, last))

    @classmethod
    def of_map(cls, tensor_map: TensorMap, cut_position: FloatArray | None = None) -> "TravelGraph":
        """Return the graph of a map.

        Args:
            tensor_map: The map.
            cut_position: `(L + 1,)` where its segments were cut, if that is known better than from
                its scans: by default half-way between a segment's last scan and the next one's
                first.

        Raises:
            InvalidParameters: If a cut does not lie between the scans of its segments.
        """
        starts = tensor_map.model.segment_start
        cuts: FloatArray = np.asarray(starts - 0.5 if cut_position is None else cut_position)
        if cuts.shape != starts.shape or (cuts > starts).any() or (cuts < starts - 1).any():
            raise InvalidParameters(
                "a cut lies between the last scan before it and the first after"
            )
        steps = _steps_m(tensor_map)
        scans = len(tensor_map)
        links = _links(tensor_map)
        count = np.bincount(links[:, 0], minlength=2 * scans)
        share = 1.0 / count[links[:, 0]]
        ahead = csr_array((share, (links[:, 1], links[:, 0])), shape=(2 * scans, 2 * scans))
        length = np.array([_link_m(tensor_map, steps, one, two) for one, two in links.tolist()])
        known = np.where(np.isnan(length), 0.0, length)
        step_m: FloatArray = np.bincount(links[:, 0], share * known, 2 * scans).astype(np.float64)
        step_m[np.unique(links[np.isnan(length), 0])] = np.nan
        along_m = np.concatenate([[0.0], np.cumsum(steps)])
        return cls(
            tensor_map.model.segment_of_scan, cuts, tensor_map.segment_ends, ahead, step_m, along_m
        )


def _steps_m(tensor_map: TensorMap) -> FloatArray:
    """Return metres between consecutive rows, `(K - 1,)`: 0 from one drive to the next."""
    steps = np.linalg.norm(np.diff(tensor_map.trajectory.poses[:, :3], axis=0), axis=1)
    steps[tensor_map.trajectory.drive_start[1:-1] - 1] = 0.0
    return np.asarray(steps)


def _links(tensor_map: TensorMap) -> NDArray[np.int64]:
    """Return every `(place, place one scan ahead)`, `(n, 2)`; at least one from each place."""
    starts = tensor_map.model.segment_start
    within = np.ones(len(tensor_map), bool)
    within[starts[1:] - 1] = False
    rows = np.flatnonzero(within)
    links = [np.stack([2 * rows, 2 * rows + 2], 1), np.stack([2 * rows + 3, 2 * rows + 1], 1)]
    met: list[tuple[int, int]] = []
    for segment in range(len(starts) - 1):
        for forward in (True, False):
            leaving = _end_place(starts, segment, forward=forward)
            entered = [
                # To enter a segment is to leave it the other way round, turned about.
                _end_place(starts, entry.segment, forward=not entry.forward) ^ 1
                for entry in tensor_map.topology.neighbours(segment, forward=forward)
            ]
            met += [(leaving, place) for place in entered or [leaving]]
    return np.concatenate([*links, np.array(met, dtype=np.int64).reshape(-1, 2)])


def _end_place(starts: IntArray, segment: int, *, forward: bool) -> int:
    """Return the place at which a segment is left."""
    return 2 * int(starts[segment + 1] - 1) if forward else 2 * int(starts[segment]) + 1


def _link_m(tensor_map: TensorMap, steps: FloatArray, one: int, two: int) -> float:
    """Return the metres of one link."""
    if one == two:
        return 0.0
    rows = sorted((one // 2, two // 2))
    if rows[1] - rows[0] == 1:
        return float(steps[rows[0]])
    apart = tensor_map.trajectory.poses[rows[1], :3] - tensor_map.trajectory.poses[rows[0], :3]
    return float(np.linalg.norm(apart))
