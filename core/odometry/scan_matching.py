"""Scan after scan registered to those before it."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidScan
from core.loop_closure.closure import check_scans
from core.odometry.registration import Registration, RegistrationParameters
from core.progress import Progress
from core.scans.drive import Drive
from core.scans.rigid import exact, inverse, rotation_deg
from core.scans.scan import Scan

_SURPRISE_M, _SURPRISE_DEG = 0.7, 3.0  # from constant velocity: more is checked
_NEAR_M = 1.0  # between a return and one of the scan before it
_WORSE_FIT = 0.85  # of the best fit of the scans before: a vehicle that starts at once
_FITS = 10  # of the scans before that are compared
_LEAST_FIT = 0.35  # of the returns near one of the scan before it; less is no registration
_LEAST_RETURNS = 20  # that are used, about 1.5 m apart: fewer fit anywhere
_PROBABLE = 0.5  # of a guess by the images of both scans


@dataclass(frozen=True, eq=False)
class Matched:
    """The poses of a drive's scans in the frame of the first one.

    Attributes:
        poses: `(K, 4, 4)`; a scan that cannot be used has that of the one before it.
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
        moved_m = points_m @ pose[:3, :3].T + pose[:3, 3]
        apart_m, _ = self._tree.query(moved_m, distance_upper_bound=_NEAR_M)
        return float(np.isfinite(apart_m).mean())


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

    def match(self, scan: Scan) -> bool:
        """Register a scan; return whether it fits the one before."""
        dense, few = self._registration.thinned(scan.points_m.astype(np.float64))
        step, deviation, fit = np.eye(4), np.eye(4), 1.0
        if self._before is not None:
            step, fit = self._registered(few, scan, self._before)
            if len(few) < _LEAST_RETURNS:
                fit = 0.0
            deviation = step if self._step is None else inverse(self._step) @ step
            self._follows = fit >= _LEAST_FIT
            if self._follows:
                self._step = step
                self._fits.append(fit)
        self.pose = exact(self.pose @ step)
        self._registration.add(dense, self.pose, deviation)
        self._before = _Before(scan, dense)
        return fit >= _LEAST_FIT

    def _registered(self, few: FloatArray, scan: Scan, before: _Before) -> tuple[FloatArray, float]:
        """Return the pose of a scan in the frame of the one before, and how well it fits that."""
        expected = np.eye(4) if self._step is None else self._step
        step = self._aligned(few, expected)
        fit = before.fit(few, step)
        deviation = inverse(expected) @ step
        if (
            self._follows
            and fit >= max(_LEAST_FIT, _WORSE_FIT * max(self._fits))
            and np.linalg.norm(deviation[:3, 3]) <= _SURPRISE_M
            and rotation_deg(deviation) <= _SURPRISE_DEG
        ):
            return step, fit
        try:
            found = check_scans(before.scan, scan, self._sensor_height_m)
        except InvalidScan:
            return step, fit
        if found.probability is None or found.probability < _PROBABLE:
            return step, fit
        other = self._aligned(few, found.planar_pose)
        other_fit = before.fit(few, other)
        return (other, other_fit) if other_fit > fit else (step, fit)

    def _aligned(self, few: FloatArray, guess: FloatArray) -> FloatArray:
        registration = self._registration
        pose = registration.aligned(few, self.pose @ guess, registration.sigma_m)
        return inverse(self.pose) @ pose


def match_scans(
    drive: Drive,
    parameters: RegistrationParameters,
    sensor_height_m: float,
    progress: Progress,
) -> Matched:
    """Register every scan of a drive to those before it.

    Args:
        drive: The drive; its poses are not used.
        parameters: The registration's parameters.
        sensor_height_m: Above ground.
        progress: Receives every scan.
    """
    matcher = _Matcher(parameters, sensor_height_m)
    poses = np.tile(np.eye(4), (len(drive), 1, 1))
    usable, registered = np.zeros(len(drive), bool), np.zeros(len(drive), bool)
    progress.start("odometry", len(drive))
    for at in range(len(drive)):
        try:
            registered[at] = matcher.match(drive.scan(at))
            usable[at] = True
        except InvalidScan:  # left out of maps too, with a note
            pass
        poses[at] = matcher.pose
        progress.advance()
    return Matched(poses, usable, registered)
