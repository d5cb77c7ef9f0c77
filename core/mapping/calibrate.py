"""From probes of a map to its calibration: positives, and negatives whose place is left out.

A *positive* queries the map with a probe of scan i, without i and what was recorded within a metre
of it: a vehicle is never exactly there. It is right if the match is within `AWAY_M` of i. A
*negative* is the same query without the whole neighbourhood of i: any match is wrong.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.confidence.calibration import Calibration, distance_ratio
from core.confidence.logistic import fit_logistic
from core.confidence.places import away_from, close_along_m, elsewhere_from
from core.confidence.spread import Spread, along_spread_m, fit_heading_variance, fit_variance
from core.encodings.basis import Basis
from core.encodings.search import Neighbours, Search
from core.mapping.estimate import estimate
from core.mapping.own_place import image_of, own_place
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan
from core.progress import NO_PROGRESS, Progress
from core.projection.images import Probes
from core.projection.visibility import SECTORS
from core.scans.angles import wrapped_deg
from core.scans.displacement import pose_beside
from core.scans.pose import heading_deg
from core.scans.sampling import spread_evenly

MOST_PROBES = 400
"""How many probes of a map are used at most, evenly spread over its drives."""

_LEAST = 10  # samples of each kind
_HERE_SCANS = 2  # of each probe, the nearest in place and as many elsewhere, compared by distance
_MOST_SEEN = 0.9  # quantile: where few scans see less, those that see more set the scale
_FLOOR = 0.05  # of the median distance of right answers
_SPARSE = 0.5  # of the fewest occupied cells that a probe has
# Of azimuths: a probe's hidden sector leaves a third of a view all around, and may be all of a
# narrower one than it is wide.
_LEFT, _MAY_BE_HIDDEN = 1.0 / 3.0, 2.0 / 3.0
_SEED = 20_003


@dataclass(frozen=True)
class _Answer:
    """The best distance, the runner-up's away from it, and whether the best is right."""

    distance: float
    runner_up: float  # NaN without one
    right: bool
    odds_of_signature: float = math.nan  # NaN without it, or without its runner-up


@dataclass(frozen=True, eq=False)
class _Error:
    """The error of a right answer, and its neighbours' distances."""

    distance: float
    along_m: FloatArray
    distances: FloatArray
    errors: tuple[float, float, float]  # along, lateral, heading


@dataclass(frozen=True, eq=False)
class _Probed:
    """What one probe shows.

    Attributes:
        cells: The occupied cells of its image.
        azimuths: The share of azimuths that it sees.
        evidence: `Search.evidence` of its query.
        answers: Its positive and its negative, as far as there are scans to search.
        at_scan: Distances of single scans, and whether each is of the probe's place.
        errors: The error of a right positive; none where poses are unknown.
    """

    cells: int
    azimuths: float
    evidence: float
    answers: list[_Answer]
    at_scan: list[tuple[float, bool]]
    errors: list[_Error]


def calibrate(
    tensor_map: TensorMap,
    probes: Probes,
    progress: Progress = NO_PROGRESS,
    *,
    by_images: bool = False,
) -> Calibration | None:
    """Return the calibration of a map; it depends only on the map and its probes.

    Args:
        tensor_map: The map, by images with its calibration of signatures, if it has one.
        probes: The probes of the map's own scans.
        progress: Receives each probe.
        by_images: Whether for queries by images, which are compared with verification images, and
            not for signatures.

    Returns:
        The calibration; `None` if the map is too small: fewer than ten right answers or ten wrong
        ones, for example if all scans are one neighbourhood.
    """
    basis, rng = tensor_map.basis(), np.random.default_rng(_SEED)
    used = spread_evenly(np.arange(len(probes.rows)), MOST_PROBES).tolist()
    progress.start("calibrating scans" if by_images else "calibrating", len(used))
    probed: list[_Probed] = []
    for probe in used:
        probed.append(_probed(tensor_map, basis, probes, probe, rng, by_images=by_images))
        progress.advance()
    answers = [answer for one in probed for answer in one.answers]
    at_scan = [sample for one in probed for sample in one.at_scan]
    right = sum(answer.right for answer in answers)
    if min(right, len(answers) - right) < _LEAST or not at_scan:
        return None
    # Probes are disturbed in several ways at once and separate less sharply than a drive's scans.
    sharper = tensor_map.parameters.encoder.sharper
    fitted = _fitted(answers, at_scan, [error for one in probed for error in one.errors], sharper)
    return replace(
        fitted,
        least_cells=_least_cells(
            np.array([one.cells for one in probed]), np.array([one.azimuths for one in probed])
        ),
        evidence=float(np.quantile([one.evidence for one in probed], _MOST_SEEN)),
    )


def _probed(
    tensor_map: TensorMap,
    basis: Basis,
    probes: Probes,
    probe: int,
    rng: np.random.Generator,
    *,
    by_images: bool,
) -> _Probed:
    """Query a map with one of its probes: as a positive, as a negative, and at single scans."""
    trajectory, row = tensor_map.trajectory, int(probes.rows[probe])
    image = image_of(tensor_map, probes.images, probe)
    view = basis.view(image)
    search = (
        tensor_map.model.search_image(image, basis)
        if by_images
        else tensor_map.model.search_values(basis.project(image), view)
    )
    beside, here = own_place(trajectory, row)
    elsewhere = elsewhere_from(trajectory, row)
    seen = 1.0 - len(view.hidden) / SECTORS
    answers: list[_Answer] = []
    at_scan: list[tuple[float, bool]] = []
    errors: list[_Error] = []
    if here.any():
        match, answer = _answer(tensor_map, search, beside, here)
        answers.append(answer)
        if answer.right:
            displacement = probes.displacement[probe]
            errors = _error(tensor_map, search, match, beside, row, displacement)
    if elsewhere.any():
        answers.append(_answer(tensor_map, search, elsewhere, ~elsewhere)[1])
    if here.any() and elsewhere.any():
        at_scan = _at_scan(tensor_map, search, row, here, elsewhere, rng)
    return _Probed(image.occupied_cells, seen, search.evidence, answers, at_scan, errors)


def _least_cells(cells: IntArray, azimuths: FloatArray) -> int:
    """Return the fewest occupied cells of a query that is answered.

    In a map of a sensor that a hidden sector can blind, probes of which less is left than of any
    that sees all around do not count: with them a scan of ten returns was enough.

    Args:
        cells: `(n,)` occupied cells of the probes.
        azimuths: `(n,)` the share of azimuths that each sees.
    """
    usual = float(np.quantile(azimuths, _MOST_SEEN))
    if usual <= _MAY_BE_HIDDEN:
        cells = cells[azimuths >= _LEFT * usual]
    return int(_SPARSE * cells.min())


def _answer(
    tensor_map: TensorMap, search: Search, among: BoolArray, right: BoolArray
) -> tuple[Neighbours, _Answer]:
    found = search.nearest(1, among)
    row = int(found.rows[0])
    away = among & away_from(tensor_map.trajectory, row)
    distance, runner_up = float(found.distances[0]), _nearest(search, away)
    of_signature, odds = search.by_signature, math.nan
    if of_signature is not None and tensor_map.calibration is not None:
        [by_signature] = of_signature.distances_of(found.rows[:1]).tolist()
        if not math.isnan(nearest := _nearest(of_signature, away)):
            ratio = distance_ratio(by_signature, nearest)
            odds = tensor_map.calibration.log_odds(by_signature, ratio)
    return found, _Answer(distance, runner_up, bool(right[row]), odds)


def _nearest(search: Search, among: BoolArray) -> float:
    found = search.nearest(1, among)
    return float(found.distances[0]) if len(found) else math.nan


def _at_scan(
    tensor_map: TensorMap,
    search: Search,
    row: int,
    here: BoolArray,
    elsewhere: BoolArray,
    rng: np.random.Generator,
) -> list[tuple[float, bool]]:
    """Return distances of some scans of the probe's place, and of as many elsewhere."""
    trajectory = tensor_map.trajectory
    close = np.flatnonzero(here)
    gap = np.abs(close - row).astype(np.float64)
    if trajectory.known[row]:
        gap_m = np.linalg.norm(trajectory.poses[close, :3] - trajectory.poses[row, :3], axis=1)
        gap = np.where(np.isnan(gap_m), np.inf, gap_m)
    close = close[np.argsort(gap, kind="stable")[:_HERE_SCANS]]
    far = rng.choice(np.flatnonzero(elsewhere), len(close))
    compared = np.zeros(len(trajectory), dtype=bool)
    compared[close] = compared[far] = True
    distances = search.distances(compared)
    return [
        (distance, is_here)
        for rows, is_here in ((close, True), (far, False))
        for distance in distances[rows].tolist()
    ]


def _error(
    tensor_map: TensorMap,
    search: Search,
    found: Neighbours,
    among: BoolArray,
    row: int,
    displacement: FloatArray,
) -> list[_Error]:
    """Return the error of a match's place; nothing where poses are unknown."""
    poses = tensor_map.trajectory.poses
    ahead_m, left_m, turn_deg = displacement.tolist()
    true = pose_beside(poses[row], left_m, turn_deg, ahead_m)
    matched = poses[found.rows[0]]
    near = close_along_m(tensor_map.trajectory, int(found.rows[0]))
    if near is None or not np.isfinite(true).all():
        return []
    yaw_deg = none_if_nan(found.relative_yaw_deg[0])
    pose = estimate(search, tensor_map.trajectory, int(found.rows[0]), yaw_deg, among).pose
    estimated = matched if pose is None else np.array(pose.as_tuple())
    rows, along_m = near
    kept = among[rows]
    compared = np.zeros(len(poses), dtype=bool)
    compared[rows[kept]] = True
    x_m, y_m = (estimated - true)[:2].tolist()
    turn = float(heading_deg(estimated[None])[0] - heading_deg(true[None])[0])
    # `along` and `lateral` are of the matched scan's path, whatever the heading of the probe.
    path = math.radians(heading_deg(matched[None])[0])
    forward_m = x_m * math.cos(path) + y_m * math.sin(path)
    left_m = y_m * math.cos(path) - x_m * math.sin(path)
    return [
        _Error(
            float(found.distances[0]),
            along_m[kept],
            search.distances(compared)[rows[kept]],
            (forward_m, left_m, wrapped_deg(turn)),
        )
    ]


def _fitted(
    answers: list[_Answer],
    at_scan: list[tuple[float, bool]],
    errors: list[_Error],
    sharper: float,
) -> Calibration:
    distance = np.array([answer.distance for answer in answers])
    right = np.array([answer.right for answer in answers])
    typical = float(np.median(distance[right])) or float(distance.max()) or 1.0
    floor = _FLOOR * typical
    far = np.log(distance + floor)
    alone = fit_logistic(far[:, None], right, np.zeros(1))
    runner_up = np.array([answer.runner_up for answer in answers])
    known = ~np.isnan(runner_up)
    both = np.array([alone[0], alone[1], 0.0])
    if min(right[known].sum(), (~right[known]).sum()) >= _LEAST:
        best, away = distance[known], runner_up[known]
        alike = np.divide(best, away, out=np.ones_like(best), where=away > 0.0)
        features = np.column_stack([far[known], alike])
        both = fit_logistic(features, right[known], np.zeros(2))
    of_scan, here = np.array(at_scan).T
    likelihood = fit_logistic(np.log(of_scan + floor)[:, None], here.astype(bool), np.zeros(1))
    calibration = Calibration(
        floor, tuple(sharper * both), tuple(sharper * alone), tuple(likelihood)
    )
    return replace(
        calibration,
        spread=_spread(calibration, errors, typical),
        with_signature=_with_signature(calibration, answers, sharper),
    )


def _with_signature(
    calibration: Calibration, answers: list[_Answer], sharper: float
) -> tuple[float, float, float] | None:
    """Return what `Calibration.with_signature` is, `None` where signatures add nothing.

    The slopes are drawn towards those of images alone, 1 and 0: of few answers, or of such as
    images decide, signatures change little.
    """
    both = [of for of in answers if not math.isnan(of.runner_up + of.odds_of_signature)]
    right = np.array([answer.right for answer in both], dtype=bool)
    if min(right.sum(), (~right).sum()) < _LEAST:
        return None
    odds = [
        (
            calibration.log_odds(of.distance, distance_ratio(of.distance, of.runner_up)),
            of.odds_of_signature,
        )
        for of in both
    ]
    fitted = np.array(odds) / sharper
    found = fit_logistic(-fitted, right, np.array([1.0, 0.0]), known=fitted[:, 0])
    intercept, less_of_images, less_of_signature = found.tolist()
    if less_of_signature == 0.0:
        return None
    return sharper * intercept, max(0.0, 1.0 - less_of_images), -less_of_signature


def _spread(calibration: Calibration, errors: list[_Error], typical: float) -> Spread | None:
    if len(errors) < _LEAST:
        return None
    along, lateral, turn = np.array([error.errors for error in errors]).T
    spread = np.array(
        [along_spread_m(e.along_m, calibration.log_likelihood_ratio(e.distances)) for e in errors]
    )
    far = np.maximum(1.0, np.array([error.distance for error in errors]) / typical)
    across, heading = fit_variance(lateral, far), fit_heading_variance(turn, far)
    return Spread(typical, fit_variance(along, spread), across, heading)
