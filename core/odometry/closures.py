"""Loop closures of a drive: proposed by signatures, checked and measured with the returns."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.errors import EmptyDrive, InvalidScan
from core.loop_closure.closure import ClosureDecision, check_scans
from core.mapping.pipeline import build, project_scans
from core.mapping.tensormap import TensorMap
from core.odometry.posed_drive import PosedDrive
from core.odometry.registration import Registration, RegistrationParameters
from core.odometry.structure import share_near
from core.parameters import MapParameters
from core.progress import Progress
from core.scans.drive import Drive, scan_index_of
from core.scans.pose import rows_from_matrices
from core.scans.rigid import are_near, inverse
from core.scans.sampling import spread_evenly

_SPACING_M = 2.0  # between the scans whose signatures are compared
_MOST_SCANS = 1500  # of these
_MOST_QUERIES = 150  # of these, evenly spread, that are searched for
_AWAY_M = 50.0  # least path between the scans of a closure: what is nearer is known well
_NEAR_M = 15.0  # most between them by odometry that does not drift,
_DRIFT = 0.03  # and this share of the path between them more
_CANDIDATES = 2  # of a query that are checked, best first
_APART_M = 10.0  # between these along the path
_AROUND = 5  # scans before and after, of which the map that measures a closure is made
_SIGMA_M = 0.7  # of the pose that the check returns
_FARTHEST_M, _FARTHEST_DEG = 3.0, 6.0  # between that pose and the measured one
_MATCHED_M = 0.5  # between a return and one of the other scans
_LEAST_MATCHED = 0.5  # of the returns


@dataclass(frozen=True)
class Closure:
    """Two scans of a drive at one place, and the pose of the second in the frame of the first."""

    first: int
    second: int
    pose: FloatArray


def find_closures(
    drive: Drive,
    poses: FloatArray,
    usable: BoolArray,
    levelling: FloatArray,
    parameters: RegistrationParameters,
    sensor_height_m: float,
    progress: Progress,
) -> tuple[Closure, ...]:
    """Find the loop closures of a drive.

    Args:
        drive: The recording.
        poses: `(K, 4, 4)` of its scans by odometry.
        usable: `(K,)` which scans can be used.
        levelling: `(4, 4)` rotation of the sensor's frame that makes it level.
        parameters: The registration's parameters.
        sensor_height_m: Above ground.
        progress: Receives the scans that are projected, and those that are searched for.
    """
    # Each step counts, of a vehicle that turns on the spot too: the accuracy was measured so.
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    if along_m[-1] < _AWAY_M:
        return ()
    spacing_m = max(_SPACING_M, along_m[-1] / _MOST_SCANS)
    usable_rows = np.flatnonzero(usable)
    _, first = np.unique(np.floor(along_m[usable_rows] / spacing_m), return_index=True)
    rows = usable_rows[first]
    pairs = _near_pairs(poses[rows], along_m[rows])
    if not pairs.any():
        return ()
    map_parameters = MapParameters.for_sensor(sensor_height_m=sensor_height_m)
    try:
        made = build(
            [PosedDrive(drive, rows_from_matrices(poses))],
            map_parameters,
            lambda posed: project_scans(posed, rows, map_parameters, progress, most_probes=0),
            calibrated=False,
            progress=progress,
        )
    except EmptyDrive:
        return ()
    tensor_map = made.tensor_map
    # Scans that could not be projected are not in the map.
    rows = rows[np.isin(scan_index_of(drive)[rows], tensor_map.trajectory.scan_index)]
    pairs = _near_pairs(poses[rows], along_m[rows])
    queries = spread_evenly(np.flatnonzero(pairs.any(axis=1)), _MOST_QUERIES)
    checker = _Checker(drive, poses, usable, levelling, parameters, sensor_height_m)
    found: list[Closure] = []
    progress.start("closing loops", len(queries))
    for query, candidates in _candidates(tensor_map, queries, pairs, along_m[rows]):
        for candidate in candidates:
            closure = checker.closure(int(rows[candidate]), int(rows[query]))
            if closure is not None:
                found.append(closure)
                break
        progress.advance()
    return tuple(found)


def _near_pairs(poses: FloatArray, along_m: FloatArray) -> BoolArray:
    """Return which pairs of scans may be at one place, `(n, n)`, the second one of rows."""
    apart_m = np.linalg.norm(poses[:, None, :2, 3] - poses[None, :, :2, 3], axis=2)
    between_m = along_m[:, None] - along_m[None, :]
    return np.asarray((between_m >= _AWAY_M) & (apart_m <= _NEAR_M + _DRIFT * between_m))


def _candidates(
    tensor_map: TensorMap, queries: IntArray, pairs: BoolArray, along_m: FloatArray
) -> Iterator[tuple[int, list[int]]]:
    """Yield each query, and the scans that are most like it, best first."""
    model = tensor_map.model
    segments = np.unique(model.segment_of_scan)
    signatures = model.own_queries(queries.tolist(), tensor_map.basis_digest, segments)
    for query, own in zip(queries.tolist(), signatures, strict=True):
        among = pairs[query].copy()
        chosen: list[int] = []
        search = model.search(own)
        while len(chosen) < _CANDIDATES and among.any():
            chosen.append(int(search.nearest(1, among).rows[0]))
            among &= np.abs(along_m - along_m[chosen[-1]]) >= _APART_M
        yield query, chosen


@dataclass(frozen=True)
class _Checker:
    drive: Drive
    poses: FloatArray
    usable: BoolArray
    levelling: FloatArray
    parameters: RegistrationParameters
    sensor_height_m: float

    def closure(self, first: int, second: int) -> Closure | None:
        """Return the measured closure of two scans, `None` if they are not at one place."""
        query = self.drive.scan(second)
        try:
            checked = check_scans(self.drive.scan(first), query, self.sensor_height_m)
        except InvalidScan:
            return None
        if checked.decide() != ClosureDecision.ACCEPTED:
            return None
        guess = inverse(self.levelling) @ checked.planar_pose @ self.levelling
        registration, around_m = self._map_around(first)
        _, few = registration.thinned(query.points_m.astype(np.float64))
        pose = registration.aligned(few, guess, _SIGMA_M)
        if not are_near(guess, pose, _FARTHEST_M, _FARTHEST_DEG):
            return None
        from scipy.spatial import cKDTree  # only drives without poses need it

        matched = share_near(cKDTree(around_m), few, pose, _MATCHED_M)
        return Closure(first, second, pose) if matched >= _LEAST_MATCHED else None

    def _map_around(self, row: int) -> tuple[Registration, FloatArray]:
        """Return a map of the scans around one, in its frame, and its points."""
        registration = Registration(self.parameters)
        to_row = inverse(self.poses[row])
        points_m = []
        for at in range(max(0, row - _AROUND), min(len(self.poses), row + _AROUND + 1)):
            if self.usable[at]:
                dense, _ = registration.thinned(self.drive.scan(at).points_m.astype(np.float64))
                pose = to_row @ self.poses[at]
                registration.add(dense, pose, np.eye(4))
                points_m.append(dense @ pose[:3, :3].T + pose[:3, 3])
        return registration, np.concatenate(points_m)
