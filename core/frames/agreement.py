"""Checks whether the drives of a map are in one world frame, by matching their scans.

A drive with poses in another frame gives each place two positions in the map. Its scans still match
those of the other drives, and where a match is clear, the poses of both scans must agree.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.errors import FramesDisagree
from core.frames.consensus import Consensus, find_consensus
from core.frames.matches import Matches, along_path, clear_matches, places, verified
from core.mapping.tensormap import TensorMap
from core.progress import NO_PROGRESS, Progress
from core.scans.pose import heading_deg
from core.scans.rigid import RigidTransform
from core.scans.trajectory import Trajectory

ALONG_M = 5.0
"""Most between a match and the place by the poses: scans are metres apart."""

# Chosen on recorded drives and simulated cities, and measured on others:
# docs/decisions/0028-frames-and-the-gate.md and 0041-one-frame.md.
_ACROSS_M = 10.0  # likewise to the side: other lanes are similar, and renderings reach 3 m
_PLACES = 8  # least number that agree on a transform
_STRETCH_M = 10.0  # around the scans that agree; most clear matches in it must agree
_MOST_CLEAR_AGREE = 0.5
_FEW_AS_CLAIMED = 0.25  # of them, most that agree with the poses: more do in streets that repeat
_TILTED_MORE = 1.2  # ratio of matches that agree with another vertical, to accept it
_STEP_M = 25.0  # most between two matches in turn that follow one path
_NEAR_M = 20.0  # between paths that would share a place
_NAMED = 5  # scans in the message


@dataclass(frozen=True)
class Evidence:
    """Matches that contradict the poses of a drive.

    Attributes:
        others: The drives with the matched scans.
        scans: `(scan, drive, scan there, metres apart)` of each.
        clear: Number of clear matches in the same stretches of the drive.
        transformed: Whether metres are from the poses after the best transform.
    """

    others: tuple[str, ...]
    scans: tuple[tuple[int, str, int, float], ...]
    clear: int
    transformed: bool = False

    @property
    def apart_m(self) -> float:
        """The median of the metres apart."""
        return float(np.median([apart_m for *_, apart_m in self.scans]))

    def __str__(self) -> str:
        step = max(1, len(self.scans) // _NAMED)
        return ", ".join(
            f"{scan} matches {other} of {drive} {apart_m:.1f} m away"
            for scan, drive, other, apart_m in self.scans[::step][:_NAMED]
        )


@dataclass(frozen=True)
class FrameCheck:
    """The check of one drive's frame.

    Attributes:
        drive: The drive's name.
        queries: Number of its scans that were matched with other drives.
        clear: Number of clear matches.
        agreeing: Number of clear matches that agree with the poses.
        disagreement: The evidence for another frame, `None` if there is none.
        transform: The transform from the frame of the drive's poses to that of the others, if one
            explains the disagreement.
        middle_m: The middle of the scans that it was found with, by the drive's poses.
        near: Whether its poses, which the matches do not confirm, come near those of the others:
            there the graph joins them.
    """

    drive: str
    queries: int
    clear: int
    agreeing: int
    disagreement: Evidence | None = None
    transform: RigidTransform | None = None
    middle_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    near: bool = False

    @property
    def met(self) -> bool:
        """Whether enough matches agree with the poses."""
        return self.disagreement is None and 2 * self.agreeing >= max(6, self.clear)

    @property
    def note(self) -> str | None:
        """A note for the user if the frame could not be checked, `None` if it was."""
        if self.met or self.disagreement is not None:
            return None
        note = f"{self}: whether they share a world frame could not be checked"
        if not self.near:
            return note
        return (
            f"{note}; by its poses it comes within {_NEAR_M:g} m of theirs, where the graph joins"
            " streets: if each begins in a frame of its own, align them (align: auto), or leave it"
            " out"
        )

    def __str__(self) -> str:
        found = self.disagreement
        if found is None:
            return (
                f"of {self.queries} scans of drive {self.drive} {self.clear} have a clear match in"
                f" other drives, {self.agreeing} of them where its poses say"
            )
        others, count = ", ".join(found.others), f"{len(found.scans)} of {found.clear}"
        if self.transform is None:
            return (
                f"no transform brings the poses of drive {self.drive} into the frame of {others}:"
                f" {count} clear matches follow their paths {found.apart_m:.1f} m (median) from"
                f" where its poses{', best transformed,' if found.transformed else ''} say: scan"
                f" {found}"
            )
        return (
            f"the poses of drive {self.drive} are in another world frame than those of {others}:"
            f" {count} clear matches agree on a place {found.apart_m:.1f} m (median) from where its"
            f" poses say: scan {found}; {self.transform.about(np.array(self.middle_m))} they would"
            " fit"
        )


def check_frames(
    tensor_map: TensorMap,
    progress: Progress = NO_PROGRESS,
    *,
    frameless: Collection[str] = (),
    confirmed: Collection[str] = (),
) -> tuple[FrameCheck, ...]:
    """Match every drive's scans with the drives before it, and compare their poses.

    The queries are the map's own signatures, so that the result depends on the map only. Matches do
    not depend on the poses of the drive that is checked.

    Args:
        tensor_map: The map of one or more drives, built with the poses to check.
        progress: Receives every scan that is matched.
        frameless: Names of drives that are left out: their poses have no frame of their own.
        confirmed: Names of drives whose poses were confirmed before: they are not matched again,
            and count as before all others.

    Returns:
        A check for each drive that was matched: of those with poses all but the first, and but the
        confirmed ones.
    """
    trajectory = tensor_map.trajectory
    drives = [d for d, name in enumerate(trajectory.drives) if name not in frameless]
    drives.sort(key=lambda drive: trajectory.drives[drive] not in confirmed)
    pairs = [
        (drive, rows, among)
        for before, drive in enumerate(drives)
        if trajectory.drives[drive] not in confirmed
        and len(rows := rows_to_match(trajectory, drive))
        and (among := known_rows(trajectory, drives[:before])).any()
    ]
    if pairs:
        progress.start("checking frames", sum(len(rows) for _, rows, _ in pairs))
    checks = []
    for drive, rows, among in pairs:
        matches = clear_matches(tensor_map, rows, among, progress)
        check = _check_frame(tensor_map, drive, matches, among)
        if check.note is not None:
            poses = trajectory.poses[known_rows(trajectory, [drive])]
            check = replace(check, near=share_places(poses, trajectory.poses[among]))
        checks.append(check)
    return tuple(checks)


def require_one_frame(checks: Sequence[FrameCheck]) -> tuple[str, ...]:
    """Require that no drive is in another frame; return a note on each that is not checked.

    Raises:
        FramesDisagree: If one is; with the evidence of the first.
    """
    for check in checks:
        if check.disagreement is not None:
            aligned = "" if check.transform is None else "align it (align: auto), "
            raise FramesDisagree(
                f"{check}: {aligned}correct its poses, leave it out, or do not check them (align:"
                " off)"
            )
    return tuple(filter(None, (check.note for check in checks)))


def rows_to_match(trajectory: Trajectory, drive: int) -> IntArray:
    """Return the rows of a drive that are matched: with poses, spread along its path."""
    rows = np.flatnonzero(trajectory.known & (trajectory.drive_of_scan == drive))
    return along_path(trajectory, rows) if len(rows) else rows


def known_rows(trajectory: Trajectory, drives: Sequence[int]) -> BoolArray:
    """Return which rows are of some drives and have poses, `(K,)`."""
    return np.asarray(trajectory.known & np.isin(trajectory.drive_of_scan, drives))


def share_places(poses: FloatArray, others: FloatArray) -> bool:
    """Return whether a path comes near others."""
    from scipy.spatial import KDTree  # no answer needs it: decision 33

    apart_m, _ = KDTree(others[:, :2]).query(poses[:, :2])
    return bool(np.min(apart_m) <= _NEAR_M)


def _check_frame(
    tensor_map: TensorMap, drive: int, matches: Matches, among: BoolArray
) -> FrameCheck:
    """Return whether the poses of one drive agree with its matches.

    Args:
        tensor_map: The map.
        drive: The drive's position in the map.
        matches: The drive's clear matches.
        among: `(K,)` the rows that were searched.
    """
    trajectory = tensor_map.trajectory
    agrees = as_claimed(trajectory, matches)
    facts = (trajectory.drives[drive], matches.queries, len(matches), int(agrees.sum()))
    left = np.flatnonzero(~agrees)
    found = explained(matches, left)
    if found is not None:
        support = left[found.agrees]
        stretch = _stretch(matches, support)
        if (stretch & agrees).sum() <= _FEW_AS_CLAIMED * len(support):
            evidence = _evidence(trajectory, matches.only(support), int(stretch.sum()))
            middle_m = matches.points_m[support].mean(axis=0)
            return FrameCheck(*facts, evidence, found.transform, tuple(middle_m.tolist()))
    return FrameCheck(*facts, unexplained(tensor_map, matches, ~agrees, among))


def as_claimed(trajectory: Trajectory, matches: Matches) -> BoolArray:
    """Return which matches lie where the poses say, `(n,)`."""
    ahead = np.radians(heading_deg(trajectory.poses[matches.found]))
    x_m, y_m, z_m = (matches.matched_m - matches.points_m).T
    along_m = np.hypot(x_m * np.cos(ahead) + y_m * np.sin(ahead), z_m)
    across_m = np.abs(y_m * np.cos(ahead) - x_m * np.sin(ahead))
    return np.asarray((along_m <= ALONG_M) & (across_m <= _ACROSS_M))


def explained(matches: Matches, chosen: IntArray) -> Consensus | None:
    """Return the transform that chosen matches agree on, if there is enough evidence for it.

    Args:
        matches: All clear ones of a drive.
        chosen: Indices of those that may agree.
    """
    some = matches.only(chosen)
    found = find_consensus(some.points_m, some.matched_m, some.turn_deg, ALONG_M)
    tilted = find_consensus(some.points_m, some.matched_m, None, ALONG_M, level=False)
    if tilted is not None and (
        found is None or tilted.agrees.sum() > _TILTED_MORE * found.agrees.sum()
    ):
        found = tilted
    if found is None:
        return None
    support = some.only(found.agrees)
    if places(support.points_m, support.matched_m) < _PLACES:
        return None
    if len(support) < _MOST_CLEAR_AGREE * _stretch(matches, chosen[found.agrees]).sum():
        return None
    return found


def _stretch(matches: Matches, support: IntArray) -> BoolArray:
    """Return which matches are of the parts of the drive in which some of them are, `(n,)`."""
    gaps_m = np.linalg.norm(matches.points_m[:, None] - matches.points_m[support][None], axis=2)
    return np.asarray(gaps_m.min(axis=1) <= _STRETCH_M)


def unexplained(
    tensor_map: TensorMap,
    matches: Matches,
    left: BoolArray,
    among: BoolArray,
    transform: RigidTransform | None = None,
) -> Evidence | None:
    """Return the evidence that a drive meets others although its poses do not fit, if there is any.

    Such matches, in the drive's order and without others between, follow a path of the others past
    at least eight places, and verification images confirm most of them.

    Args:
        tensor_map: The map.
        matches: All clear ones of a drive.
        left: `(n,)` which are not where the poses, transformed, say.
        among: `(K,)` the rows that were searched.
        transform: The transform of the poses; none by default.
    """
    if not left.any():
        return None
    steps_m = np.linalg.norm(np.diff(matches.matched_m, axis=0), axis=1)
    parted = np.concatenate([[True], ~(left[1:] & left[:-1] & (steps_m <= _STEP_M))])
    kept: list[IntArray] = []
    for run in np.split(np.arange(len(matches)), np.flatnonzero(parted)[1:]):
        if left[run[0]] and places(matches.matched_m[run]) >= _PLACES:
            confirmed = verified(tensor_map, matches.only(run), among)
            if places(confirmed.matched_m) >= _PLACES:
                kept.append(run)
    if not kept:
        return None
    found = matches.only(np.concatenate(kept))
    return _evidence(tensor_map.trajectory, found, len(matches), transform)


def _evidence(
    trajectory: Trajectory, matches: Matches, clear: int, transform: RigidTransform | None = None
) -> Evidence:
    own_m: FloatArray = matches.points_m if transform is None else transform.apply(matches.points_m)
    scans = matches.named(trajectory, own_m)
    drives = tuple(dict.fromkeys(drive for _, drive, *_ in scans))
    return Evidence(drives, scans, clear, transform is not None)
