"""Scan after scan registered to those before it."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidScan
from core.loop_closure.closure import check_scans
from core.odometry.registration import Registration, RegistrationParameters
from core.odometry.structure import share_near
from core.progress import Progress
from core.scans.drive import Drive, recorded_index_of
from core.scans.rigid import are_near, exact, inverse, rotation_deg
from core.scans.scan import Scan

_SURPRISE_M, _SURPRISE_DEG = 0.7, 3.0  # from constant velocity: more is checked
_NEAR_M = 1.0  # between a return and one of the scan before it
_WORSE_FIT = 0.85  # of the best fit of the scans before: a vehicle that starts at once
_FITS = 10  # of the scans before that are compared
_LEAST_FIT = 0.35  # of the returns near one of the scan before it; less is no registration
_LEAST_RETURNS = 20  # that are used, about 1.5 m apart: fewer fit anywhere
_PROBABLE = 0.5  # of a guess by the images of both scans
_SURE = 0.99  # of the same behind a gap, as for a closure
# Scans are missing between two that are more periods apart: two that were lost make three, and the
# clock of a recording by distance reaches 2.5. On a street 0.35 of the returns fit anywhere then.
_GAP = 2.6
_MOST_PERIODS = 30  # for which the velocity before a gap is kept: 3 s at 10 Hz
_CHANGED = 0.15  # of the motion across a gap, by which the velocity may change it
# Of the usual fit before a gap, a metre and at all: on recorded and simulated streets right ones
# fall by 0.01 a metre, and wrong ones near the guess are below 0.65.
_FIT_FALLS, _LEAST_FIT_ACROSS = 0.01, 0.65


@dataclass(frozen=True, eq=False)
class Matched:
    """The poses of a drive's scans in the frame of the first one.

    Attributes:
        poses: `(K, 4, 4)`; a scan that cannot be used has that of the one before it, and one with
            the same returns too: they were measured there.
        usable: `(K,)` which scans could be used.
        registered: `(K,)` which were registered to those before; the first one counts.
    """

    poses: FloatArray
    usable: BoolArray
    registered: BoolArray


class _Before:
    """The scan before, and its returns to find those of the next one near them."""

    def __init__(self, scan: Scan, points_m: FloatArray) -> None:
        from scipy.spatial import cKDTree  # only drives without poses need it

        self.scan = scan
        self._tree = cKDTree(points_m) if len(points_m) else None

    def fit(self, points_m: FloatArray, pose: FloatArray) -> float:
        """Return the share of the next scan's returns that are near one, if that is its pose."""
        if self._tree is None or not len(points_m):
            return 0.0
        return share_near(self._tree, points_m, pose, _NEAR_M)


class _Matcher:
    """Registers scan after scan; `pose` is that of the last one."""

    def __init__(self, parameters: RegistrationParameters, sensor_height_m: float) -> None:
        self.pose = np.eye(4)
        self._registration = Registration(parameters)
        self._sensor_height_m = sensor_height_m
        self._step: FloatArray | None = None  # the last one that was registered
        self._follows = False  # whether that is the step to the last scan
        self._before: _Before | None = None
        self._fits: deque[float] = deque(maxlen=_FITS)
        self._has_few = False  # whether the last scan has too few returns

    def match(self, scan: Scan, periods: float) -> bool:
        """Register a scan, so many periods after the one before; return whether it fits that."""
        dense, few = self._registration.thinned(scan.points_m.astype(np.float64))
        step, deviation, fit = np.eye(4), np.eye(4), 1.0
        self._has_few = len(few) < _LEAST_RETURNS
        if self._before is not None:
            is_gap = periods > _GAP
            if is_gap:
                step, fit = self._across(
                    few, scan, self._before, round(min(periods, _MOST_PERIODS))
                )
            else:
                step, fit = self._registered(few, scan, self._before)
                deviation = step if self._step is None else inverse(self._step) @ step
            if self._has_few:
                fit = 0.0
            self._follows = fit >= _LEAST_FIT
            if self._follows and not is_gap:
                self._step = step
                self._fits.append(fit)
        self.pose = exact(self.pose @ step)
        self._registration.add(dense, self.pose, deviation)
        self._before = _Before(scan, dense)
        return fit >= _LEAST_FIT

    def repeats(self, scan: Scan) -> bool:
        """Return whether a scan has the returns of the last one, which noise makes impossible.

        Too few returns may be equal: those of a sensor that sees nothing.
        """
        if self._before is None or self._has_few:
            return False
        return _are_equal(self._before.scan, scan)

    def _registered(self, few: FloatArray, scan: Scan, before: _Before) -> tuple[FloatArray, float]:
        """Return the pose of a scan in the frame of the one before, and how well it fits that."""
        expected = np.eye(4) if self._step is None else self._step
        step = self._aligned(few, expected)
        fit = before.fit(few, step)
        if (
            self._follows
            and self._fits  # none of a drive whose first step was across a gap
            and fit >= max(_LEAST_FIT, _WORSE_FIT * max(self._fits))
            and are_near(expected, step, _SURPRISE_M, _SURPRISE_DEG)
        ):
            return step, fit
        seen = _seen(before.scan, scan, self._sensor_height_m, _PROBABLE)
        if seen is None:
            return step, fit
        other = self._aligned(few, seen)
        other_fit = before.fit(few, other)
        return (other, other_fit) if other_fit > fit else (step, fit)

    def _across(
        self, few: FloatArray, scan: Scan, before: _Before, periods: int
    ) -> tuple[FloatArray, float]:
        """Return the same behind a gap; the guess and 0 where no registration is sure.

        One is that stays near the guess, where the velocity before the gap leads, and fits as well
        as scans so far apart do; or one that the images of both scans confirm.
        """
        guess = np.eye(4)
        if self._step is not None:
            guess = np.linalg.matrix_power(self._step, periods)
            step = self._aligned(few, guess)
            fit = before.fit(few, step)
            moved_m = float(np.linalg.norm(step[:3, 3]))
            share = max(_WORSE_FIT - _FIT_FALLS * moved_m, _LEAST_FIT_ACROSS)
            most_m = _SURPRISE_M + _CHANGED * periods * float(np.linalg.norm(self._step[:3, 3]))
            most_deg = _SURPRISE_DEG + _CHANGED * periods * float(rotation_deg(self._step))
            if fit >= share * np.median(self._fits) and are_near(guess, step, most_m, most_deg):
                return step, fit
        seen = _seen(before.scan, scan, self._sensor_height_m, _SURE)
        if seen is not None:
            step = self._aligned(few, seen)
            fit = before.fit(few, step)
            if are_near(seen, step, _SURPRISE_M, _SURPRISE_DEG):
                return step, fit
        return guess, 0.0

    def _aligned(self, few: FloatArray, guess: FloatArray) -> FloatArray:
        registration = self._registration
        pose = registration.aligned(few, self.pose @ guess, registration.sigma_m)
        return inverse(self.pose) @ pose


def _seen(first: Scan, second: Scan, sensor_height_m: float, least: float) -> FloatArray | None:
    """Return the pose of a scan in another's frame by their images, if that is so probable."""
    try:
        found = check_scans(first, second, sensor_height_m)
    except InvalidScan:
        return None
    return found.planar_pose if (found.probability or 0.0) >= least else None


def _are_equal(one: Scan, other: Scan) -> bool:
    return np.array_equal(one.points_m, other.points_m)


def _repeats(drive: Drive, start: int) -> BoolArray:
    """Return which scans after `start` have the returns of the one before, `(K,)`."""
    found = np.zeros(len(drive), bool)
    before: Scan | None = None
    for at in range(start, len(drive)):
        try:
            scan = drive.scan(at)
        except InvalidScan:
            continue
        found[at] = before is not None and _are_equal(before, scan)
        before = scan
    return found


def _clock(drive: Drive, distinct: BoolArray) -> FloatArray:
    """Return when each scan was recorded, `(K,)` in usual periods from scan to scan.

    By the times where they are known, else by the scans' numbers.

    Args:
        drive: The drive.
        distinct: `(K,)` the scans between which periods are usual ones: a recorder that stores
            each scan several times has a longer one.
    """
    index = recorded_index_of(drive)
    usual = np.diff(index[distinct]).astype(np.float64)
    periods = np.diff(index) / (np.median(usual) if len(usual) else 1.0)
    lasted_s = np.diff(drive.timestamp_s)
    usual_s = np.diff(drive.timestamp_s[distinct])
    timed = np.isfinite(lasted_s)
    known_s = usual_s[np.isfinite(usual_s)]
    if len(known_s) and (period_s := float(np.median(known_s))) > 0.0:
        periods = np.where(timed, lasted_s / period_s, periods)
    return np.concatenate([[0.0], np.cumsum(periods)])


def match_scans(
    drive: Drive,
    parameters: RegistrationParameters,
    sensor_height_m: float,
    progress: Progress,
) -> Matched:
    """Register every scan of a drive to those before it.

    A scan with the very returns of the one before shows no motion: the sensor or its driver did not
    go on. It is passed over, so that several are a gap.

    Args:
        drive: The drive; its poses are not used.
        parameters: The registration's parameters.
        sensor_height_m: Above ground.
        progress: Receives every scan.
    """
    matcher = _Matcher(parameters, sensor_height_m)
    poses = np.tile(np.eye(4), (len(drive), 1, 1))
    usable, registered = np.zeros(len(drive), bool), np.zeros(len(drive), bool)
    distinct = np.ones(len(drive), bool)
    clock, last = _clock(drive, distinct), 0
    progress.start("odometry", len(drive))
    for at in range(len(drive)):
        try:
            scan = drive.scan(at)
            if matcher.repeats(scan):
                if distinct.all():  # few drives have any: only these are read twice
                    distinct = ~_repeats(drive, last)
                    clock = _clock(drive, distinct)
                registered[at] = True
            else:
                registered[at] = matcher.match(scan, clock[at] - clock[last])
                last = at
            usable[at] = True
        except InvalidScan:  # left out of maps too, with a note
            pass
        poses[at] = matcher.pose
        progress.advance()
    return Matched(poses, usable, registered)
