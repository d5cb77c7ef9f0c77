"""Checks of proposed loop closures: whether two scans show one place (paper, sec. 4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.special import expit

from core.arrays import Float32Array, FloatArray
from core.encodings.signature import Signature
from core.errors import InvalidParameters
from core.localization.localizer import Localizer
from core.loop_closure.birds_eye_view import align_views
from core.projection.height_image import project_heights
from core.projection.imager import LATERAL_RENDERINGS_M
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.angles import wrapped_deg
from core.scans.displacement import seen_from_beside
from core.scans.scan import Scan

ACCEPT_FROM = 0.99
"""Least probability to accept a closure; a false one would distort a whole map."""

_GRID = RingGrid()
_LEAST = 1e-6
_PEAKS = 3  # headings that are compared: opposite directions of a street are similar
_APART_DEG = 10.0  # between them
_AROUND_DEG = np.arange(-2.0, 3.0)  # of each: columns of an image are a degree wide

# Of a logistic curve, fitted to simulated drives: docs/decisions/0015-loop-closures.md.
_INTERCEPT, _OF_SIMILARITY, _OF_OVERLAP = -7.0, 8.8, 10.6


class Verdict(StrEnum):
    """Decision on a proposed closure."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class LoopClosure:
    """A checked closure between a first and a second scan.

    Attributes:
        probability: That they are within some 5 m of each other, with even prior odds; `None` if
            not known.
        turn_deg: Relative yaw of the second, counter-clockwise, -180..180; `None` if not known, as
            from the paper's signatures.
        forward_m: Distance of the second ahead of the first; `None` likewise.
        lateral_m: Its distance to the left; `None` likewise.
        image_similarity: Of the height images in the best heading, at most 1, less that of any
            heading; `None` without returns.
        overlap: Of the bird's-eye views in the best alignment, at most 1, likewise.
        signature_distance: In the measure of the map, `None` without signatures.
    """

    probability: float | None
    turn_deg: float | None = None
    forward_m: float | None = None
    lateral_m: float | None = None
    image_similarity: float | None = None
    overlap: float | None = None
    signature_distance: float | None = None

    def __post_init__(self) -> None:
        if self.probability is not None and not 0.0 <= self.probability <= 1.0:
            raise InvalidParameters(f"probability is {self.probability}, wanted 0..1")

    def decide(self, accept_from: float = ACCEPT_FROM) -> Verdict:
        """Accept or reject the closure, or leave it undecided.

        Args:
            accept_from: The least probability to accept; below a half it is rejected.

        Raises:
            InvalidParameters: If that is not above 0.5 and at most 1.
        """
        if not 0.5 < accept_from <= 1.0:
            raise InvalidParameters(f"accept_from is {accept_from}, wanted above 0.5, at most 1")
        if self.probability is None:
            return Verdict.UNDECIDED
        if self.probability >= accept_from:
            return Verdict.ACCEPTED
        return Verdict.REJECTED if self.probability < 0.5 else Verdict.UNDECIDED


def check_scans(first: Scan, second: Scan, sensor_height_m: float) -> LoopClosure:
    """Check a closure by both scans' returns.

    Their height images are compared in every heading, from virtual viewpoints too; then their
    bird's-eye views in the best headings, with all shifts within 5 m. The result depends on no map,
    encoding or sensor, but on the sensors' height.

    Args:
        first: The scan that the answer is relative to.
        second: The other one.
        sensor_height_m: Of both sensors above ground.

    Raises:
        InvalidScan: If one has no return above the ground within 80 m.
    """
    similarity, turns_deg = _similarity(first, second, sensor_height_m)
    found = align_views(first, second, turns_deg, sensor_height_m)
    return LoopClosure(
        closure_probability(similarity, found.overlap),
        turn_deg=wrapped_deg(found.turn_deg),
        forward_m=found.forward_m,
        lateral_m=found.lateral_m,
        image_similarity=similarity,
        overlap=found.overlap,
    )


def check_signatures(
    localizer: Localizer, row: int, signatures: Sequence[Signature]
) -> LoopClosure:
    """Check a closure between a scan of a map and one of which only signatures are known.

    Far less reliable than `check_scans`: similar streets have nearly the same signatures. The
    probability is that of the map's calibration, `None` without one.

    Args:
        localizer: Of the map.
        row: Of the map's scan, the first of the closure.
        signatures: Of the second, made with the map's basis; only the one of the first scan's
            segment is used.

    Raises:
        TensorMapError: As `Localizer.compare`.
    """
    found = localizer.compare(signatures, row)
    probability = None
    if (calibration := localizer.map.calibration) is not None:
        probability = float(expit(calibration.log_likelihood_ratio(found.distances)[0]))
    return LoopClosure(
        probability,
        turn_deg=_given(found.relative_yaw_deg),
        lateral_m=_given(found.lateral_m),
        signature_distance=float(found.distances[0]),
    )


def _given(of_match: FloatArray) -> float | None:
    return None if np.isnan(of_match[0]) else float(of_match[0])


def closure_probability(image_similarity: float, overlap: float) -> float:
    """Return the probability of a closure with that evidence.

    Examples:
        >>> closure_probability(0.7, 0.7) > 0.99, closure_probability(0.2, 0.2) < 0.1
        (True, True)
    """
    return float(expit(_INTERCEPT + _OF_SIMILARITY * image_similarity + _OF_OVERLAP * overlap))


def _similarity(first: Scan, second: Scan, sensor_height_m: float) -> tuple[float, FloatArray]:
    """Return the greatest similarity over headings and viewpoints, and the best headings.

    The similarity is the cosine above the median over all headings, as a share of the most that is
    possible.
    """
    query = _heights(second, sensor_height_m)
    spectrum = np.fft.rfft(query, axis=1)
    norm = float(np.linalg.norm(query))
    best, correlation = -1.0, np.zeros(_GRID.columns)
    for left_m in LATERAL_RENDERINGS_M:
        aside = first
        if left_m:
            aside = Scan(seen_from_beside(first.points_m, left_m).astype(np.float32))
        view = _heights(aside, sensor_height_m)
        product = (spectrum * np.conj(np.fft.rfft(view, axis=1))).sum(axis=0)
        cosines = np.fft.irfft(product, _GRID.columns) / (norm * float(np.linalg.norm(view)))
        by_chance = float(np.median(cosines))
        above = (float(cosines.max()) - by_chance) / max(1.0 - by_chance, _LEAST)
        if above > best:
            best, correlation = above, cosines
    return min(1.0, best), _headings(correlation)


def _heights(scan: Scan, sensor_height_m: float) -> Float32Array:
    return project_heights(scan, _GRID, Reducer.MEAN, sensor_height_m)


def _headings(correlation: FloatArray) -> FloatArray:
    """Return the headings at the highest peaks, and those around them, `(n,)` degrees."""
    step_deg = 360.0 / len(correlation)
    left = correlation.copy()
    turns: list[float] = []
    for _ in range(_PEAKS):
        turn_deg = -float(left.argmax()) * step_deg
        turns.append(turn_deg)
        away = np.abs(wrapped_deg(-step_deg * np.arange(len(left), dtype=np.float64) - turn_deg))
        left[away < _APART_DEG] = -np.inf
    return np.asarray(np.add.outer(turns, _AROUND_DEG)).ravel()
