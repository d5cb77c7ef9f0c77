"""Is a proposed loop closure true: do two scans show one place? (paper, sec. 4)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from core.arrays import Float32Array, FloatArray
from core.encodings.signature import Signature
from core.errors import InvalidParameters
from core.localization.localizer import Localizer
from core.loop_closure.birds_eye_view import align_overhead
from core.projection.height_image import project_heights
from core.projection.imager import LATERAL_RENDERINGS_M
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.angles import wrapped_deg
from core.scans.displacement import seen_from_beside
from core.scans.scan import Scan

ACCEPT_FROM = 0.99
"""A false closure bends a whole map: it is accepted only if this probable."""

_GRID = RingGrid()
_LEAST = 1e-6
_PEAKS = 3  # headings that are tried: opposite directions of a street look alike from within
_APART_DEG = 10.0  # between them
_AROUND_DEG = np.arange(-2.0, 3.0)  # of each: columns of an image are a degree wide

# Of a logistic curve, fitted to simulated drives: docs/decisions/0015-loop-closures.md.
_INTERCEPT, _OF_SIMILARITY, _OF_OVERLAP = -7.0, 8.8, 10.6


class Verdict(StrEnum):
    """What to do with a proposed closure."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"


class Likelihood(Protocol):
    """What a map's calibration knows of distances between signatures."""

    def log_likelihood_ratio(self, distances: FloatArray) -> FloatArray:
        """Return log p(d | the query is at this scan) - log p(d | it is elsewhere), `(n,)`."""


@dataclass(frozen=True)
class LoopClosure:
    """A proposed closure between a first and a second scan, judged.

    Attributes:
        probability: That they stand within some 5 m of each other, true and false being as likely
            beforehand; `None` if nothing tells.
        turn_deg: How far the second is turned from the first, counter-clockwise, -180..180; `None`
            where the evidence does not tell, as the paper's signatures.
        forward_m: How far ahead of the first the second stands; `None` likewise.
        lateral_m: How far to its left; `None` likewise.
        image_similarity: Of the height images in the best heading, at most 1, what they have in
            common in any heading taken off; `None` without returns.
        overlap: Of the views from above as they lie best, at most 1, likewise.
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

    def verdict(self, accept_from: float = ACCEPT_FROM) -> Verdict:
        """Return what to do with it.

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


def check_scans(
    first: Scan, second: Scan, first_height_m: float, second_height_m: float | None = None
) -> LoopClosure:
    """Judge a closure by both scans' returns.

    Their height images are compared in every heading, the second also from the sides of the first;
    then both are laid over each other from above, in the best headings and wherever within 5 m.
    Nothing depends on a map, its encoding or its sensor but the sensors' heights.

    Args:
        first: The scan that the answer is relative to.
        second: The other one.
        first_height_m: Of the first one's sensor above ground.
        second_height_m: Of the second one's, if it is another.

    Raises:
        InvalidScan: If one has no return that stands above the ground within 80 m.
    """
    height_m = first_height_m if second_height_m is None else second_height_m
    similarity, turns_deg = _images_alike(first, second, first_height_m, height_m)
    found = align_overhead(first, second, turns_deg, first_height_m, height_m)
    return LoopClosure(
        closure_probability(similarity, found.overlap),
        turn_deg=wrapped_deg(found.turn_deg),
        forward_m=found.forward_m,
        lateral_m=found.lateral_m,
        image_similarity=similarity,
        overlap=found.overlap,
    )


def check_signatures(
    localizer: Localizer,
    row: int,
    signatures: Sequence[Signature],
    likelihood: Likelihood | None,
) -> LoopClosure:
    """Judge a closure between a scan of a map and one of which only signatures are known.

    Far weaker than `check_scans`: two streets of one kind have nearly the same signature.

    Args:
        localizer: Of the map.
        row: Of the map's scan, the first of the closure.
        signatures: Of the second, made with the map's basis; only that in the basis of the first
            one's segment is used.
        likelihood: The map's calibration; without one there is no probability.

    Raises:
        TensorMapError: What `Localizer.compare` raises.
    """
    found = localizer.compare(signatures, row)
    probability = None
    if likelihood is not None:
        ratio = likelihood.log_likelihood_ratio(found.distances)
        probability = _logistic(float(ratio[0]))
    return LoopClosure(
        probability,
        turn_deg=_given(found.relative_yaw_deg),
        lateral_m=_given(found.lateral_m),
        signature_distance=float(found.distances[0]),
    )


def _given(of_match: FloatArray) -> float | None:
    return None if np.isnan(of_match[0]) else float(of_match[0])


def closure_probability(image_similarity: float, overlap: float) -> float:
    """Return how probable a closure of that evidence is.

    Examples:
        >>> closure_probability(0.7, 0.7) > 0.99, closure_probability(0.2, 0.2) < 0.1
        (True, True)
    """
    return _logistic(_INTERCEPT + _OF_SIMILARITY * image_similarity + _OF_OVERLAP * overlap)


def _images_alike(
    first: Scan, second: Scan, first_height_m: float, second_height_m: float
) -> tuple[float, FloatArray]:
    """Return how alike the images are at best, and the headings that are worth a try.

    Over headings and sides, the cosine is at best so far above that of the middle heading, as a
    share of what it could be above that.
    """
    query = _heights(second, second_height_m)
    spectrum = np.fft.rfft(query, axis=1)
    norm = float(np.linalg.norm(query))
    best, correlation = -1.0, np.zeros(_GRID.columns)
    for left_m in LATERAL_RENDERINGS_M:
        aside = first
        if left_m:
            aside = Scan(seen_from_beside(first.points_m, left_m).astype(np.float32))
        view = _heights(aside, first_height_m)
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
    """Return the turns at the highest peaks, and those around them, `(n,)` degrees."""
    step_deg = 360.0 / len(correlation)
    left = correlation.copy()
    turns: list[float] = []
    for _ in range(_PEAKS):
        turn_deg = -float(left.argmax()) * step_deg
        turns.append(turn_deg)
        away = np.abs(wrapped_deg(-step_deg * np.arange(len(left), dtype=np.float64) - turn_deg))
        left[away < _APART_DEG] = -np.inf
    return np.asarray(np.add.outer(turns, _AROUND_DEG)).ravel()


def _logistic(odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-odds)) if odds > -700.0 else 0.0
