"""Checks whether the drives of a map are in one world frame, by matching their scans.

A drive with poses in another frame gives each place two positions in the map. Its scans still match
those of the other drives, and where a match is clear, the poses of both scans must agree.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.confidence.places import away_from
from core.errors import FramesDisagree
from core.frames.rigid import RigidTransform, find_consensus
from core.localization.match import match_at
from core.mapping.tensormap import TensorMap
from core.progress import NO_PROGRESS, Progress
from core.projection.probe import spread_evenly
from core.scans.displacement import pose_beside
from core.scans.pose import heading_deg
from core.scans.trajectory import Trajectory

MOST_MATCHED = 200
"""Most scans of a drive that are matched, evenly spread along its path."""

# Chosen on recorded drives and simulated cities, and measured on others:
# docs/decisions/0028-frames-and-the-gate.md.
_CLEAR = 0.7  # a match is clear up to this ratio to the runner-up
_ALONG_M = 5.0  # most between a match and the place by the poses: scans are metres apart
_ACROSS_M = 10.0  # likewise to the side: other lanes are similar, and renderings reach 3 m
_PLACES = 8  # least number that agree on a transform
_PLACE_M = 5.0  # least between two of them: scans of one place have similar errors
_STRETCH_M = 10.0  # around the scans that agree; most clear matches in it must agree
_MOST_CLEAR_AGREE = 0.5
_FEW_AS_CLAIMED = 0.25  # of them, most that agree with the poses: more do in streets that repeat
_TILTED_MORE = 1.2  # ratio of matches that agree with another vertical, to accept it
_NAMED = 5  # scans in the message


@dataclass(frozen=True)
class Disagreement:
    """Evidence that a drive's poses are in another frame than those of the drives before it.

    Attributes:
        others: The drives with the matched scans.
        scans: `(scan, drive, scan there, metres apart)` of the matches that agree on the transform.
        matched: Number of clear matches in the same stretches of the drive.
        apart_m: The median of the metres apart.
        transform: From the frame of the drive's poses to that of the others.
    """

    others: tuple[str, ...]
    scans: tuple[tuple[int, str, int, float], ...]
    matched: int
    apart_m: float
    transform: RigidTransform


@dataclass(frozen=True)
class FrameCheck:
    """The check of one drive's frame.

    Attributes:
        drive: Its name.
        queries: Number of its scans that were matched with the drives before it.
        clear: Number of clear matches.
        agreeing: Number of clear matches that agree with the poses.
        disagreement: The evidence for another frame, `None` if there is none.
    """

    drive: str
    queries: int
    clear: int
    agreeing: int
    disagreement: Disagreement | None

    @property
    def met(self) -> bool:
        """Whether enough matches agree with the poses."""
        return self.disagreement is None and 2 * self.agreeing >= max(6, self.clear)

    @property
    def note(self) -> str | None:
        """A note for the user if the frame could not be checked, `None` if it was."""
        if self.met or self.disagreement is not None:
            return None
        return f"{self}: whether they share a world frame could not be checked"

    def __str__(self) -> str:
        found = self.disagreement
        if found is None:
            return (
                f"of {self.queries} scans of drive {self.drive} {self.clear} have a clear match in"
                f" the drives before it, {self.agreeing} of them where its poses say"
            )
        step = max(1, len(found.scans) // _NAMED)
        named = ", ".join(
            f"{scan} matches {other} of {drive} {apart_m:.1f} m away"
            for scan, drive, other, apart_m in found.scans[::step][:_NAMED]
        )
        x_m, y_m, z_m = found.transform.translation_m.tolist()
        tilt_deg = found.transform.tilt_deg
        tilted = f", its vertical tilted by {tilt_deg:.1f} deg" if tilt_deg > 1.0 else ""
        return (
            f"the poses of drive {self.drive} are in another world frame than those of"
            f" {', '.join(found.others)}: {len(found.scans)} of {found.matched} clear matches agree"
            f" on a place {found.apart_m:.1f} m (median) from where its poses say: scan {named};"
            f" turned by {found.transform.yaw_deg:.1f} deg{tilted} and then moved by"
            f" ({x_m:.1f}, {y_m:.1f}, {z_m:.1f}) m they would fit"
        )


def check_frames(tensor_map: TensorMap, progress: Progress = NO_PROGRESS) -> tuple[FrameCheck, ...]:
    """Match every drive's scans with the drives before it, and compare their poses.

    The queries are the map's own signatures, so that the result depends on the map only. Matches do
    not depend on the poses of the drive that is checked.

    Args:
        tensor_map: Of one or more drives, built with the poses to check.
        progress: Receives every scan that is matched.

    Returns:
        A check for each drive with poses but the first.
    """
    trajectory = tensor_map.trajectory
    pairs = list(_pairs(trajectory))
    if pairs:
        progress.start("checking frames", sum(len(rows) for rows, _ in pairs))
    checks = []
    for rows, among in pairs:
        matches = _clear_matches(tensor_map, rows, among, progress)
        checks.append(
            FrameCheck(
                trajectory.drives[trajectory.drive_of_scan[rows[0]]],
                queries=len(rows),
                clear=len(matches.rows),
                agreeing=int(matches.agrees.sum()),
                disagreement=_disagreement(trajectory, matches),
            )
        )
    return tuple(checks)


def require_one_frame(checks: Sequence[FrameCheck]) -> None:
    """Require that no drive is in another frame.

    Raises:
        FramesDisagree: With the evidence of the first one that is.
    """
    for check in checks:
        if check.disagreement is not None:
            raise FramesDisagree(
                f"{check}: correct its poses, leave it out, or insist with poses unchecked"
            )


def _pairs(trajectory: Trajectory) -> Iterator[tuple[IntArray, BoolArray]]:
    """Yield rows of each drive to match, and the rows to match them with."""
    drive_of_scan, known = trajectory.drive_of_scan, trajectory.known
    for drive in range(1, len(trajectory.drives)):
        rows = np.flatnonzero(known & (drive_of_scan == drive))
        among = known & (drive_of_scan < drive)
        if len(rows) and among.any():
            yield _along_path(trajectory, rows), among


def _along_path(trajectory: Trajectory, rows: IntArray) -> IntArray:
    """Return some rows, evenly spread along a drive's path."""
    steps_m = np.linalg.norm(np.diff(trajectory.poses[rows, :3], axis=0), axis=1)
    path_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    spacing_m = max(1.0, path_m[-1] / MOST_MATCHED)
    _, first = np.unique(np.floor(path_m / spacing_m), return_index=True)
    return spread_evenly(rows[first], MOST_MATCHED)


@dataclass(frozen=True, eq=False)
class _Matches:
    """Clear matches: rows, the rows they match, and the positions of both."""

    rows: IntArray
    found: IntArray
    points_m: FloatArray
    matched_m: FloatArray
    turn_deg: FloatArray | None
    agrees: BoolArray


def _clear_matches(
    tensor_map: TensorMap, rows: IntArray, among: BoolArray, progress: Progress
) -> _Matches:
    trajectory, poses = tensor_map.trajectory, tensor_map.trajectory.poses
    model = tensor_map.model
    # As from a vehicle; the paper's are converted to the bases of the drives before.
    segments = np.unique(model.segment_of_scan[among])
    queries = model.own_queries(rows.tolist(), tensor_map.basis_digest, segments)
    kept: list[tuple[int, int]] = []
    places: list[tuple[FloatArray, FloatArray]] = []
    for row, signatures in zip(rows.tolist(), queries, strict=True):
        search = model.search(signatures)
        found = search.nearest(1, among)
        nearest = int(found.rows[0])
        away = search.nearest(1, among & away_from(trajectory, nearest))
        if len(away) and found.distances[0] < _CLEAR * away.distances[0]:
            pose = match_at(tensor_map, search, found).estimated_pose
            kept.append((row, nearest))
            places.append(
                (
                    pose_beside(poses[row], model.recorded_lateral_m),
                    poses[nearest] if pose is None else np.array(pose.as_tuple()),
                )
            )
        progress.advance()
    pairs = np.array(kept, dtype=np.int64).reshape(-1, 2)
    both = np.array(places, dtype=np.float64).reshape(-1, 2, 7)
    mine, theirs = both[:, 0], both[:, 1]
    # Without yaw invariance a scan matches only queries in its own heading.
    turns_known = model.gives_relative_yaw or not tensor_map.parameters.encoder.yaw_invariant
    ahead = np.radians(heading_deg(poses[pairs[:, 1]]))
    x_m, y_m, z_m = (theirs - mine)[:, :3].T
    along_m = np.hypot(x_m * np.cos(ahead) + y_m * np.sin(ahead), z_m)
    across_m = np.abs(y_m * np.cos(ahead) - x_m * np.sin(ahead))
    return _Matches(
        pairs[:, 0],
        pairs[:, 1],
        mine[:, :3],
        theirs[:, :3],
        heading_deg(theirs) - heading_deg(mine) if turns_known else None,
        (along_m <= _ALONG_M) & (across_m <= _ACROSS_M),
    )


def _disagreement(trajectory: Trajectory, matches: _Matches) -> Disagreement | None:
    """Return the transform that matches against the poses agree on, if there is enough evidence."""
    others = np.flatnonzero(~matches.agrees)
    points_m, matched_m = matches.points_m[others], matches.matched_m[others]
    turn_deg = None if matches.turn_deg is None else matches.turn_deg[others]
    found = find_consensus(points_m, matched_m, turn_deg, _ALONG_M)
    tilted = find_consensus(points_m, matched_m, None, _ALONG_M, level=False)
    if tilted is not None and (
        found is None or tilted.agrees.sum() > _TILTED_MORE * found.agrees.sum()
    ):
        found = tilted
    if found is None or _places(points_m[found.agrees], matched_m[found.agrees]) < _PLACES:
        return None
    support = others[found.agrees]
    gaps_m = np.linalg.norm(matches.points_m[:, None] - matches.points_m[support][None], axis=2)
    stretch = gaps_m.min(axis=1) <= _STRETCH_M
    if len(support) < _MOST_CLEAR_AGREE * stretch.sum():
        return None
    if (stretch & matches.agrees).sum() > _FEW_AS_CLAIMED * len(support):
        return None
    apart_m = np.linalg.norm((matches.points_m - matches.matched_m)[support], axis=1)
    rows = matches.found[support]
    drives = [trajectory.drives[drive] for drive in trajectory.drive_of_scan[rows].tolist()]
    scans = zip(
        trajectory.scan_index[matches.rows[support]].tolist(),
        drives,
        trajectory.scan_index[rows].tolist(),
        apart_m.tolist(),
        strict=True,
    )
    return Disagreement(
        others=tuple(dict.fromkeys(drives)),
        scans=tuple(scans),
        matched=int(stretch.sum()),
        apart_m=float(np.median(apart_m)),
        transform=found.transform,
    )


def _places(points_m: FloatArray, matched_m: FloatArray) -> int:
    """Return the number of matches when none is near another, in either frame."""
    both = np.stack([points_m, matched_m], axis=1)
    kept: list[FloatArray] = []
    for place in both:
        if all((np.linalg.norm(place - other, axis=1) >= _PLACE_M).all() for other in kept):
            kept.append(place)
    return len(kept)
