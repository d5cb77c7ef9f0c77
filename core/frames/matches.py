"""Clear matches: scans of a drive that are recognised at one place of other drives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.confidence.places import AWAY_M, away_from
from core.encodings.search import Neighbours, Search
from core.localization.match import match_at
from core.mapping.tensormap import TensorMap
from core.progress import Progress
from core.scans.displacement import pose_beside
from core.scans.path import arc_lengths_m
from core.scans.pose import heading_deg, verticals
from core.scans.sampling import spread_evenly
from core.scans.trajectory import Trajectory

MOST_MATCHED = 200
"""Most scans of a drive that are matched, evenly spread along its path."""

PLACE_M = 5.0
"""Least between two places: the errors of scans of one place are similar."""

# Chosen on recorded drives and simulated cities, and measured on others:
# docs/decisions/0028-frames-and-the-gate.md.
_CLEAR = 0.7  # a match is clear up to this ratio to the runner-up


@dataclass(frozen=True, eq=False)
class Matches:
    """Clear matches of a drive.

    Attributes:
        queries: Number of its scans that were matched.
        rows: `(n,)` those with a clear match, rising.
        found: `(n,)` the rows that they match.
        points_m: `(n, 3)` positions of the first by their poses.
        matched_m: `(n, 3)` positions of the same by their matches.
        vertical: `(n, 3)` the sensor's z axis of the first by their poses.
        matched_vertical: `(n, 3)` the same by their matches.
        turn_deg: `(n,)` heading by the match less that by the pose; `None` where it is unknown.
    """

    queries: int
    rows: IntArray
    found: IntArray
    points_m: FloatArray
    matched_m: FloatArray
    vertical: FloatArray
    matched_vertical: FloatArray
    turn_deg: FloatArray | None

    def __len__(self) -> int:
        return len(self.rows)

    def only(self, which: BoolArray | IntArray) -> "Matches":
        """Return some of them."""
        return Matches(
            self.queries,
            self.rows[which],
            self.found[which],
            self.points_m[which],
            self.matched_m[which],
            self.vertical[which],
            self.matched_vertical[which],
            None if self.turn_deg is None else self.turn_deg[which],
        )

    def named(
        self, trajectory: Trajectory, at_m: FloatArray
    ) -> tuple[tuple[int, str, int, float], ...]:
        """Return for each the scan, the matched drive and scan, and metres from `(n, 3)` places."""
        apart_m = np.linalg.norm(at_m - self.matched_m, axis=1)
        drives = [trajectory.drives[drive] for drive in trajectory.drive_of_scan[self.found]]
        return tuple(
            zip(
                trajectory.scan_index[self.rows].tolist(),
                drives,
                trajectory.scan_index[self.found].tolist(),
                apart_m.tolist(),
                strict=True,
            )
        )


def along_path(trajectory: Trajectory, rows: IntArray) -> IntArray:
    """Return some rows, evenly spread along a drive's path."""
    path_m = arc_lengths_m(trajectory.poses[rows, :3])
    spacing_m = max(1.0, path_m[-1] / MOST_MATCHED)
    _, first = np.unique(np.floor(path_m / spacing_m), return_index=True)
    return spread_evenly(rows[first], MOST_MATCHED)


def clear_matches(
    tensor_map: TensorMap, rows: IntArray, among: BoolArray, progress: Progress
) -> Matches:
    """Match scans of a drive with those of others by the map's own signatures.

    Args:
        tensor_map: The map of both.
        rows: The rows to match.
        among: `(K,)` rows of the others.
        progress: Receives every row.
    """
    trajectory, model = tensor_map.trajectory, tensor_map.model
    # As from a vehicle; the paper's are converted to the bases of the drives before.
    segments = np.unique(model.segment_of_scan[among])
    queries = model.own_queries(rows.tolist(), tensor_map.basis_digest, segments)
    kept: list[_Placed] = []
    for row, signatures in zip(rows.tolist(), queries, strict=True):
        search = model.search(signatures)
        found = search.nearest(1, among)
        away = search.nearest(1, among & away_from(trajectory, int(found.rows[0])))
        if len(away) and found.distances[0] < _CLEAR * away.distances[0]:
            kept.append(_placed(tensor_map, row, search, found))
        progress.advance()
    return _of(tensor_map, len(rows), kept)


def verified(tensor_map: TensorMap, matches: Matches, among: BoolArray) -> Matches:
    """Return the matches that verification images confirm, placed by these.

    Without such images, or if fewer than half are confirmed, all are returned as they are.

    Args:
        tensor_map: The map of both.
        matches: The matches of one drive.
        among: `(K,)` rows that were searched.
    """
    kept: list[_Placed] = []
    for row, matched_m in zip(matches.rows.tolist(), matches.matched_m, strict=True):
        search = tensor_map.model.search_own(row)
        if search is None:
            continue
        found = _placed(tensor_map, row, search, search.nearest(1, among))
        if np.linalg.norm(found[3][:3] - matched_m) <= AWAY_M:
            kept.append(found)
    return matches if 2 * len(kept) < len(matches) else _of(tensor_map, matches.queries, kept)


_Placed = tuple[int, int, FloatArray, FloatArray]
"""A row, the row that it matches, and the poses of both: its own and that by the match."""


def _placed(tensor_map: TensorMap, row: int, search: Search, found: Neighbours) -> _Placed:
    nearest, poses = int(found.rows[0]), tensor_map.trajectory.poses
    own = pose_beside(poses[row], tensor_map.model.recorded_lateral_m)
    pose = match_at(tensor_map, search, found).estimated_pose
    return row, nearest, own, poses[nearest] if pose is None else np.array(pose.as_tuple())


def _of(tensor_map: TensorMap, queries: int, kept: Sequence[_Placed]) -> Matches:
    rows = np.array([pair for *pair, _, _ in kept], dtype=np.int64).reshape(-1, 2)
    both = np.array([poses for _, _, *poses in kept], dtype=np.float64).reshape(-1, 2, 7)
    mine, theirs = both[:, 0], both[:, 1]
    # Without yaw invariance a scan matches only queries in its own heading.
    encoder = tensor_map.parameters.encoder
    turns_known = tensor_map.model.gives_relative_yaw or not encoder.yaw_invariant
    turn_deg = heading_deg(theirs) - heading_deg(mine) if turns_known else None
    return Matches(
        queries,
        rows[:, 0],
        rows[:, 1],
        mine[:, :3],
        theirs[:, :3],
        verticals(mine),
        verticals(theirs),
        turn_deg,
    )


def places(*points_m: FloatArray) -> int:
    """Return the number of places when none is near another, in any of the frames, `(n, 3)` each.

    Examples:
        >>> places(np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [6.0, 0.0, 0.0]]))
        2
    """
    kept: list[FloatArray] = []
    for place in np.stack(points_m, axis=1):
        if all((np.linalg.norm(place - other, axis=1) >= PLACE_M).all() for other in kept):
            kept.append(place)
    return len(kept)
