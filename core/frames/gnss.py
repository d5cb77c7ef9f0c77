"""The geographic anchor of a map, fitted to the track of a GNSS receiver on one of its drives.

The transform is rigid and about the vertical: metres of the map are metres on the Earth, and poses
of another scale do not fit.
"""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray, freeze
from core.errors import AnchorDoesNotFit, InvalidParameters
from core.frames.consensus import Consensus, find_consensus
from core.frames.fit import cauchy_weights
from core.mapping.anchor import Anchor, AnchorFit
from core.scans.angles import wrapped_deg
from core.scans.path import arc_lengths_m
from core.scans.rigid import RigidTransform
from core.scans.sampling import spread_evenly

_GAP_S = 2.0  # most between two poses: the way in between is straight
_APART_M = 2.0  # along the path: a stop counts once
_MOST_FIXES = 200
_LEAST_FIXES = 8
_SIGMAS, _LEAST_TOLERANCE_M, _MOST_TOLERANCE_M = 3.0, 5.0, 20.0
_USUAL_M = 3.0  # accuracy of a receiver that does not say it
_LEAST_AGREE = 0.5  # of the fixes
_SHARED_M = 50.0  # of path: errors of a receiver last for some seconds
_MOST_ERROR_DEG = 1.0  # 1 km away a place is 17 m off
_LEAST_SPREAD_M = 0.02
_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class GnssTrack:
    """Fixes of a receiver, in the order of time.

    Attributes:
        time_s: `(n,)` by the clock of the scans.
        places: `(n, 3)` latitude and longitude in degrees, and altitude in metres above the
            ellipsoid, NaN where unknown.
        accuracy_m: `(n,)` standard deviation of the position, NaN where unknown.
    """

    time_s: FloatArray
    places: FloatArray
    accuracy_m: FloatArray

    def __post_init__(self) -> None:
        freeze(self, time_s=np.float64, places=np.float64, accuracy_m=np.float64)

    def __len__(self) -> int:
        return len(self.time_s)


def fit_anchor(
    drive: str, timestamp_s: FloatArray, positions_m: FloatArray, track: GnssTrack
) -> Anchor:
    """Return the anchor with which a drive lies where its receiver says.

    Most fixes agree on it (RANSAC); to these it is fitted by least squares, reweighted as Cauchy's
    errors. Its point is the middle of the fixes; its altitude is the median of those that have one.

    Args:
        drive: Name of the drive.
        timestamp_s: `(K,)` of its scans, NaN where unknown.
        positions_m: `(K, 3)` in the map, NaN where unknown.
        track: The fixes.

    Raises:
        AnchorDoesNotFit: If the fixes do not fit the path, or do not give its heading.
        InvalidParameters: If there is no fix.
    """
    if not len(track):
        raise InvalidParameters(f"the track has no fix, wanted at least {_LEAST_FIXES}")
    points_m, timed = _positions_at(drive, timestamp_s, positions_m, track.time_s)
    chosen = _along_path(points_m)
    points_m, used = points_m[chosen], timed[chosen]
    if len(used) < _LEAST_FIXES:
        raise AnchorDoesNotFit(
            f"{len(timed)} of {len(track)} fixes are between two scans of drive {drive}, at"
            f" {len(used)} of the places {_APART_M:g} m apart along it, wanted {_LEAST_FIXES} or"
            f" more; the fixes are from {track.time_s.min():.3f} to {track.time_s.max():.3f} s:"
            " is the track too short, or its clock another one?"
        )
    places, has_altitude = _with_altitudes(track.places[used])
    rough = _middle(places)
    on_earth_m = rough.level_m(places)
    flat_m, flat_on_earth_m = points_m * [1, 1, 0], on_earth_m * [1, 1, 0]
    found = _consensus(drive, flat_m, flat_on_earth_m, track.accuracy_m[used])
    agrees = found.agrees
    transform, spread_m = _fitted(flat_m[agrees], flat_on_earth_m[agrees], found.transform)
    independent, error_deg = _figures(drive, flat_m[agrees], spread_m)
    x_m, y_m, z_m = points_m[agrees].mean(axis=0).tolist()
    at_m = transform.apply(np.array([[x_m, y_m, 0.0]]))
    with_altitude = agrees & has_altitude
    if with_altitude.any():
        at_m[0, 2] = float(np.median((on_earth_m - points_m)[with_altitude, 2])) + z_m
    # East at that point is not east in the middle of the fixes: at 60 degrees north and 6 km away
    # they are 0.1 degree apart.
    east_m, north_m, up_m = at_m[0].tolist()
    place = rough.pose_wgs84(east_m, north_m, up_m, transform.yaw_deg)
    return Anchor(
        place["latitude_deg"],
        place["longitude_deg"],
        place["altitude_m"] if with_altitude.any() else 0.0,
        wrapped_deg(90.0 - place["bearing_deg"]),
        x_m,
        y_m,
        z_m,
        fitted=AnchorFit(
            drive,
            fixes=len(used),
            agreeing=int(agrees.sum()),
            spread_m=round(spread_m, 3),
            error_m=round(spread_m * float(np.sqrt(2.0 / independent)), 3),
            error_deg=round(error_deg, 4),
            altitudes=int(with_altitude.sum()),
        ),
    )


def _middle(places: FloatArray) -> Anchor:
    """Return the anchor of a level frame in the middle of places, also across 180 degrees east."""
    latitude_deg, _, altitude_m = np.median(places, axis=0).tolist()
    first_deg = float(places[0, 1])
    east_deg = float(np.median(wrapped_deg(places[:, 1] - first_deg)))
    return Anchor(latitude_deg, wrapped_deg(first_deg + east_deg), altitude_m)


def _with_altitudes(places: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return places with the median altitude where they have none, and which have one.

    East and north of a fix hardly depend on its altitude: by 2 mm a kilometre and 10 m of altitude.
    """
    known = np.isfinite(places[:, 2])
    usual_m = float(np.median(places[known, 2])) if known.any() else 0.0
    altitude_m = np.where(known, places[:, 2], usual_m)
    return np.column_stack([places[:, :2], altitude_m]), known


def _consensus(
    drive: str, points_m: FloatArray, on_earth_m: FloatArray, accuracy_m: FloatArray
) -> Consensus:
    """Return the transform that most fixes agree on."""
    usual_m = float(np.median(np.where(np.isfinite(accuracy_m), accuracy_m, _USUAL_M)))
    tolerance_m = float(np.clip(_SIGMAS * usual_m, _LEAST_TOLERANCE_M, _MOST_TOLERANCE_M))
    found = find_consensus(points_m, on_earth_m, None, tolerance_m)
    agreeing = 0 if found is None else int(found.agrees.sum())
    if found is None or agreeing < max(_LEAST_FIXES, _LEAST_AGREE * len(points_m)):
        raise AnchorDoesNotFit(
            f"only {agreeing} of {len(points_m)} fixes are within {tolerance_m:g} m of drive"
            f" {drive} in the best place for it: are they of this drive, by the clock of its scans,"
            " and its poses in metres?"
        )
    return found


def _figures(drive: str, points_m: FloatArray, spread_m: float) -> tuple[float, float]:
    """Return how many independent errors the fixes have, and the heading's standard deviation."""
    arms_m = np.linalg.norm(points_m - points_m.mean(axis=0), axis=1)
    path_m = float(np.linalg.norm(np.diff(points_m, axis=0), axis=1).sum())
    independent = 1.0 + path_m / _SHARED_M
    arm_m = max(float(np.sqrt((arms_m**2).mean())), 0.1)
    error_deg = float(np.degrees(spread_m / (arm_m * np.sqrt(independent))))
    if error_deg > _MOST_ERROR_DEG:
        raise AnchorDoesNotFit(
            f"the heading is known to {error_deg:.1f} deg, wanted {_MOST_ERROR_DEG:g}: the fixes"
            f" reach {2.0 * arms_m.max():.0f} m, and are {spread_m:.1f} m (standard deviation)"
            f" beside drive {drive}: give a longer track, or a better one"
        )
    return independent, error_deg


def _positions_at(
    drive: str, timestamp_s: FloatArray, positions_m: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return where the drive was at the times of fixes, and which fixes these are."""
    known = np.flatnonzero(np.isfinite(positions_m).all(axis=1) & np.isfinite(timestamp_s))
    known = known[np.argsort(timestamp_s[known], kind="stable")]
    scans_s, scans_m = timestamp_s[known], positions_m[known]
    if len(scans_s) < 2:
        raise AnchorDoesNotFit(
            f"drive {drive} has {len(scans_s)} scans with a pose and a time in the map, wanted 2 or"
            " more: a build takes those that the drive has then"
        )
    after = np.clip(np.searchsorted(scans_s, time_s), 1, len(scans_s) - 1)
    between: BoolArray = (time_s >= scans_s[0]) & (time_s <= scans_s[-1])
    between &= scans_s[after] - scans_s[after - 1] <= _GAP_S
    if not between.any():
        raise AnchorDoesNotFit(
            f"no fix is between two scans of drive {drive}, from {scans_s[0]:.3f} to"
            f" {scans_s[-1]:.3f} s, and at most {_GAP_S:g} s apart: the fixes are from"
            f" {time_s.min():.3f} to {time_s.max():.3f} s; are both by one clock?"
        )
    at_s = time_s[between]
    points_m = np.stack([np.interp(at_s, scans_s, axis_m) for axis_m in scans_m.T], axis=1)
    return points_m, np.flatnonzero(between)


def _along_path(points_m: FloatArray) -> IntArray:
    """Return some points, spread along their path on the ground."""
    path_m = arc_lengths_m(points_m * [1, 1, 0])
    _, first = np.unique(np.floor(path_m / _APART_M), return_index=True)
    return spread_evenly(first, _MOST_FIXES)


def _fitted(
    points_m: FloatArray, matched_m: FloatArray, transform: RigidTransform
) -> tuple[RigidTransform, float]:
    """Return the robust fit, and the standard deviation of a fix in x and y, each."""
    for _ in range(_ROUNDS):
        off_m = np.linalg.norm(transform.apply(points_m) - matched_m, axis=1)
        weights, spread_m = cauchy_weights(off_m, _LEAST_SPREAD_M)
        transform = RigidTransform.fit(points_m, matched_m, level=True, weights=weights)
    return transform, spread_m
