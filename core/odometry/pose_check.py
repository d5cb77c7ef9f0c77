"""Checks the poses that came with a drive against the motion that its scans show.

Poses of another drive, in another order, unit or system of axes are as smooth as right ones: only
the scans contradict them. Pairs of scans that are a few metres apart are compared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from core.arrays import FloatArray, IntArray
from core.errors import InvalidScan
from core.loop_closure.closure import check_scans
from core.odometry.level_frame import level_frame
from core.odometry.map_frame import is_in_map_frame
from core.odometry.pose_scale import scale_of_poses
from core.odometry.structure import BETTER_FIT, LEAST_FIT, NEAR_M, Structure
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import is_known, matrices_from_rows
from core.scans.rigid import inverse, rotation_deg
from core.scans.sampling import spread_evenly
from core.scans.scan import Scan

VERSION = 1
"""Another version may come to another result."""
_MOST_PAIRS = 8  # half of them spread over the drive, half where turns begin or end
_BEND_STEPS = 3  # before and after such a place: late poses differ there
_SCANS_A_PAIR = 6  # of a drive, at least
_APART_M, _APART_DEG = 3.0, 20.0  # of a pair by its poses; the closure check reaches 5 m
_MOST_BETWEEN = 20  # scans from one of a pair to the other
_STEPS = (1, 2, 4, 8, 16)  # likewise, where the poses may be wrong
_PROBABLE = 0.9  # of a measured motion; it has to fit better than that by the poses, too
_GROUNDS = 5  # scans in which the ground below the sensor is looked for
_LEAST_M, _LEAST_DEG = 2.0, 10.0  # less is no motion: two drives agree on it by chance

# Poses are good to decimetres, and the measurement to half a cell of 0.5 m and a degree. Vehicles
# that accelerate skew their scans; an antenna is beside the sensor.
_TOLERANCE_M, _TOLERANCE_DEG, _TOLERANCE_SHARE = 0.75, 5.0, 0.15
_LEVER_M = 2.0
_ASKEW = 0.52  # 2 sin(30 deg / 2): a sensor that is tilted or turned on the vehicle of its poses
_LEAST_TURNED_DEG, _ALIKE_DEG = 6.0, 10.0  # directions are measured to a degree or two
_LEAST_AHEAD = 2  # pairs between which the sensor goes ahead
_LEAST_SHARE = 0.75  # of these, around their median
_AHEAD_DEG = 5.0  # of a turn: in a larger one an antenna 2 m ahead of the sensor goes another way
_ABOVE_GROUND_M, _FARTHEST_M = 0.5, 40.0  # of returns that are compared


@dataclass(frozen=True)
class RelativeMotion:
    """How the sensor moved from one scan to another, in the level frame of the first.

    Attributes:
        forward_m: How far ahead.
        left_m: The distance to the left.
        up_m: Upwards.
        turn_deg: Angle of the rotation, whatever its axis.
    """

    forward_m: float
    left_m: float
    up_m: float
    turn_deg: float

    @classmethod
    def of(cls, pose: FloatArray) -> "RelativeMotion":
        """Return that of a `(4, 4)` pose in the frame of the first scan, rounded."""
        forward_m, left_m, up_m = (np.round(pose[:3, 3], 2) + 0.0).tolist()  # no -0.0
        return cls(forward_m, left_m, up_m, round(float(rotation_deg(pose)), 1))

    @property
    def metres(self) -> float:
        """The distance."""
        return math.hypot(self.forward_m, self.left_m, self.up_m)

    @property
    def is_one(self) -> bool:
        """Whether it is more than what two recordings agree on by chance."""
        return self.metres >= _LEAST_M or self.turn_deg >= _LEAST_DEG

    @property
    def is_ahead(self) -> bool:
        """Whether its direction is that of all that is fixed to the vehicle."""
        return self.metres >= _LEAST_M and self.turn_deg <= _AHEAD_DEG

    def __str__(self) -> str:
        return (
            f"({self.forward_m:z.1f}, {self.left_m:z.1f}, {self.up_m:z.1f}) m and"
            f" {self.turn_deg:.0f} deg"
        )


@dataclass(frozen=True)
class Contradiction:
    """Two scans between which the sensor moved otherwise than the poses say.

    Attributes:
        first: Index of the one.
        last: The index of the other scan.
        by_poses: The motion by the poses.
        by_scans: The motion by the returns of both.
    """

    first: int
    last: int
    by_poses: RelativeMotion
    by_scans: RelativeMotion

    def __str__(self) -> str:
        return (
            f"scan {self.first} to {self.last}: {self.by_poses} by the poses, {self.by_scans} by"
            " the scans"
        )


@dataclass(frozen=True)
class PoseCheck:
    """The check of a drive's poses against its scans.

    Attributes:
        agreeing: Pairs of scans between which the sensor moved as the poses say.
        contradictions: The pairs between which it moved otherwise.
        still: Pairs between which it did not move, which say nothing.
        unmeasured: Pairs too far apart, or in surroundings that do not show the motion.
        scale: How many times as far as the scans the poses say that the sensor moved; `None` if
            that is once, or not known.
        in_map_frame: Whether the returns are in the frame of the poses, and not in the sensor's;
            then no pair is compared.
        turned_deg: How far to the left of the way by the scans the poses go; `None` if they go the
            same way to some 8 degrees, or that is not known. Poses of a vehicle agree with the
            scans of a sensor that is turned on it by up to 30 degrees; those of a straight drive in
            other axes may too.
    """

    agreeing: int
    contradictions: tuple[Contradiction, ...]
    still: int
    unmeasured: int
    scale: float | None = None
    in_map_frame: bool = False
    turned_deg: float | None = None

    @property
    def is_wrong(self) -> bool:
        """Whether these are not the poses of this drive: half of the pairs contradict them.

        Pairs on straight roads agree with the poses of many drives; a slip of a survey is one pair.
        """
        return self.in_map_frame or len(self.contradictions) >= max(2, self.agreeing)

    @property
    def is_unknown(self) -> bool:
        """Whether no pair shows anything."""
        return bool(self.unmeasured) and not (self.agreeing or self.contradictions or self.still)


def check_poses(
    drive: Drive, sensor_height_m: float, progress: Progress = NO_PROGRESS
) -> PoseCheck:
    """Compare the motion by a drive's poses with that by its scans, for a few pairs of them.

    Up to eight pairs: where the poses are right, some 50 ms each; where not, five times as much.
    Pairs that are farther apart show whether poses in general right say too long or short a way.

    Args:
        drive: The drive as its sensor recorded it, with poses of the sensor.
        sensor_height_m: Above ground, about.
        progress: Receives every pair.
    """
    if is_in_map_frame(drive):
        return PoseCheck(0, (), 0, 0, in_map_frame=True)
    rows = np.flatnonzero(is_known(drive.poses))
    checker = _Checker(drive, rows, sensor_height_m)
    starts = _starts(checker.poses)
    if starts:
        progress.start("checking poses", len(starts))
    found: list[Contradiction | _Outcome] = []
    for start in starts:
        try:
            found.append(checker.check(start))
        except InvalidScan:  # left out of maps too, with a note
            found.append(_Outcome.UNMEASURED)
        progress.advance()
    check = PoseCheck(
        found.count(_Outcome.AGREES),
        tuple(one for one in found if isinstance(one, Contradiction)),
        found.count(_Outcome.STILL),
        found.count(_Outcome.UNMEASURED),
    )
    if check.is_wrong:
        return check
    return replace(check, scale=checker.scale(), turned_deg=_common_direction(checker.turned_deg))


class _Outcome(Enum):
    """The outcome for a pair that does not contradict the poses."""

    AGREES = auto()
    STILL = auto()
    UNMEASURED = auto()


def _starts(poses: FloatArray) -> list[int]:
    """Return where pairs begin: half spread over a drive, half where its turns begin or end."""
    pairs = min(_MOST_PAIRS, len(poses) // _SCANS_A_PAIR)
    if not pairs:
        return []
    spread = np.linspace(0, len(poses), (pairs + 1) // 2, endpoint=False)
    starts = [int(start) for start in spread]
    turn_deg = rotation_deg(inverse(poses[:-1]) @ poses[1:])
    edge = np.repeat([1.0, -1.0], _BEND_STEPS) / _BEND_STEPS
    bend_deg = np.abs(np.convolve(turn_deg, edge, "valid"))
    for at in (np.argsort(-bend_deg, kind="stable") + _BEND_STEPS).tolist():
        if len(starts) == pairs:
            break
        if min(abs(at - start) for start in starts) > len(poses) // (3 * pairs):
            starts.append(at)
    return sorted(starts)


class _Checker:
    """Compares pairs of a drive's scans, in the frame of the sensor, made level.

    Attributes:
        poses: `(n, 4, 4)` of the scans.
        turned_deg: How far the poses go to the left of the scans, of each pair that agrees and
            between which the sensor goes ahead; 0 if the scans fit best as the poses say.
    """

    def __init__(self, drive: Drive, rows: IntArray, sensor_height_m: float) -> None:
        self._drive, self._rows, self._height_m = drive, rows, sensor_height_m
        self._scan_index = scan_index_of(drive)[rows]
        self.poses = matrices_from_rows(drive.poses[rows])
        self.turned_deg: list[float] = []
        self._level = level_frame(drive, spread_evenly(rows, _GROUNDS), sensor_height_m)

    def check(self, start: int) -> Contradiction | _Outcome:
        """Return what the pair that begins there shows.

        Raises:
            InvalidScan: If a scan cannot be used.
        """
        first = self._scan(start)
        structure = Structure(self._structure_m(first))
        if structure.is_little:
            return _Outcome.UNMEASURED
        end = self._apart(start)
        second_m = self._structure_m(self._scan(end))
        if structure.confirms(second_m, given := self._given(start, end)):
            by_poses = RelativeMotion.of(given)
            if by_poses.is_ahead:
                self.turned_deg.append(0.0)
            return _Outcome.AGREES if by_poses.is_one else _Outcome.STILL
        measured = None
        for step in _STEPS:  # scans as far apart as can be measured, whatever the poses say
            if start + step >= len(self._rows):
                break
            second = self._scan(start + step)
            found = check_scans(first, second, self._height_m)
            if (found.probability or 0.0) < _PROBABLE:
                break
            end, measured, second_m = start + step, found.planar_pose, self._structure_m(second)
            if RelativeMotion.of(measured).is_one:
                break
        if measured is None:
            return _Outcome.UNMEASURED
        given = self._given(start, end)
        by_poses, by_scans = RelativeMotion.of(given), RelativeMotion.of(measured)
        if not (by_poses.is_one or by_scans.is_one):
            return _Outcome.UNMEASURED
        if _agree(given, measured):
            if by_poses.is_ahead and by_scans.is_ahead:
                self.turned_deg.append(_left_deg(given, measured))
            return _Outcome.AGREES
        fit = structure.fit(second_m, measured)
        if fit < max(LEAST_FIT, structure.fit(second_m, given) + BETTER_FIT):
            return _Outcome.UNMEASURED
        first_scan, last_scan = self._scan_index[[start, end]].tolist()
        return Contradiction(first_scan, last_scan, by_poses, by_scans)

    def scale(self) -> float | None:
        """Return how many times as far as by the scans the sensor moved by the poses."""
        return scale_of_poses(self.poses, self._given, lambda at: self._structure_m(self._scan(at)))

    def _scan(self, at: int) -> Scan:
        return self._drive.scan(int(self._rows[at]))

    def _given(self, start: int, end: int) -> FloatArray:
        """Return the pose of one scan in the frame of another by the poses, `(4, 4)`."""
        moved = inverse(self.poses[start]) @ self.poses[end]
        return np.asarray(self._level @ moved @ inverse(self._level))

    def _apart(self, start: int) -> int:
        """Return the first scan after one that is far enough away by the poses."""
        last = min(start + _MOST_BETWEEN, len(self._rows) - 1)
        for end in range(start + 1, last):
            given = RelativeMotion.of(self._given(start, end))
            if given.metres >= _APART_M or given.turn_deg >= _APART_DEG:
                return end
        return last

    def _structure_m(self, scan: Scan) -> FloatArray:
        """Return returns above the ground in the level frame, one in each half metre."""
        points_m = scan.points_m @ self._level[:3, :3].T
        kept = points_m[:, 2] > _ABOVE_GROUND_M - self._height_m
        kept &= (np.abs(points_m) < _FARTHEST_M).all(axis=1)
        points_m = points_m[kept]
        cells = np.floor(points_m / NEAR_M).astype(np.int64) @ [1, 1000, 1_000_000]
        return np.asarray(points_m[np.unique(cells, return_index=True)[1]])


def _left_deg(given: FloatArray, measured: FloatArray) -> float:
    """Return how far to the left of one `(4, 4)` motion another one goes."""
    ahead, left = measured[:2, 3], np.array([-measured[1, 3], measured[0, 3]])
    return math.degrees(math.atan2(given[:2, 3] @ left, given[:2, 3] @ ahead))


def _common_direction(turned_deg: Sequence[float]) -> float | None:
    """Return the direction of most pairs, `None` if it is about ahead or there is none."""
    if len(turned_deg) < _LEAST_AHEAD:
        return None
    middle = float(np.median(turned_deg))
    alike = float((np.abs(np.array(turned_deg) - middle) <= _ALIKE_DEG).mean())
    if abs(middle) < _LEAST_TURNED_DEG or alike < _LEAST_SHARE:
        return None
    return round(middle)


def _agree(given: FloatArray, measured: FloatArray) -> bool:
    """Return whether two `(4, 4)` motions are the same within the errors of both."""
    turn_deg = float(rotation_deg(measured))
    length_m = float(np.linalg.norm(measured[:3, 3]))
    most_m = _TOLERANCE_M + _TOLERANCE_SHARE * length_m + _LEVER_M * np.radians(min(turn_deg, 60.0))
    most_deg = _TOLERANCE_DEG + _TOLERANCE_SHARE * turn_deg
    given_deg, measured_deg = _vector_deg(given), _vector_deg(measured)
    if given_deg @ measured_deg < 0.0 and np.linalg.norm(given_deg - measured_deg) > 180.0:
        # Half a turn is one to either side: 170 degrees to the left are 190 to the right.
        given_deg = given_deg * (1.0 - 360.0 / np.linalg.norm(given_deg))
    return _near(given[:3, 3], measured[:3, 3], most_m) and _near(given_deg, measured_deg, most_deg)


def _near(given: FloatArray, measured: FloatArray, most: float) -> bool:
    """Return whether vectors are equally long, and about in one direction."""
    lengths = np.linalg.norm([given, measured], axis=1)
    apart = np.linalg.norm(given - measured)
    return bool(abs(lengths[0] - lengths[1]) <= most and apart <= most + _ASKEW * lengths.max())


def _vector_deg(pose: FloatArray) -> FloatArray:
    """Return the rotation of a `(4, 4)` pose as its axis times its angle."""
    from scipy.spatial.transform import Rotation  # no answer needs it: decision 33

    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True))
