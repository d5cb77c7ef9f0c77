"""How well probabilities separate known from unknown places, and how calibrated they are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidParameters
from core.evaluation.plain import Plain
from core.evaluation.retrieval import auroc, precision_recall

BINS = 10


def expected_calibration_error(
    probability: FloatArray,
    right: BoolArray,
    *,
    adaptive: bool = False,
    weight: FloatArray | None = None,
) -> float:
    """Return the mean difference of probability and share of right answers, over ten bins.

    Args:
        probability: `(n,)` within 0..1, at least one.
        right: `(n,)`.
        adaptive: Bins of about equal count, instead of equal width; equal probabilities are of one
            bin.
        weight: `(n,)` of each sample; equal by default.

    Raises:
        InvalidParameters: If there is no sample, or a probability is not within 0..1.

    Examples:
        >>> expected_calibration_error(np.array([0.9, 0.9, 0.1]), np.array([True, False, False]))
        0.3
    """
    if not len(probability) or not ((probability >= 0.0) & (probability <= 1.0)).all():
        raise InvalidParameters("probability is empty or has numbers that are not within 0..1")
    weight = np.ones(len(probability)) if weight is None else weight
    if adaptive:
        # Equal probabilities are of one bin: in which order they come says nothing.
        firsts = np.minimum(-(-np.arange(1, BINS) * len(weight) // BINS), len(weight) - 1)
        bins = np.searchsorted(np.sort(probability)[firsts], probability, side="right")
    else:
        bins = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    gap = np.bincount(bins, weights=weight * (probability - right), minlength=BINS)
    return float(np.abs(gap).sum() / weight.sum())


@dataclass(frozen=True)
class Outcome:
    """The outcome of one query.

    Attributes:
        probability: The probability that its best match is right.
        localized: Whether the match was accepted.
        right: Whether the best match is right.
    """

    probability: float
    localized: bool
    right: bool


@dataclass(frozen=True)
class Reliability(Plain):
    """The metrics of probabilities; `None` where not applicable.

    Attributes:
        known_queries: How many scans of known places were queried.
        off_map_queries: How many other scans of those drives no scan of the map is near: they are
            in no figure.
        unknown_queries: How many scans of places that are not in the map were queried.
        auroc: Probability that a query of a known place scores above one of an unknown place.
        average_precision: The average precision of queries of known places among both.
        ece: Expected calibration error of queries of known places, ten bins of equal width.
        ece_adaptive: As `ece`, with bins of equal count.
        ece_mixed: As `ece`, queries of known and of unknown places counting half each.
        ece_mixed_adaptive: As `ece_mixed`, with bins of equal count.
        refused_right: Share of the right answers that were refused.
        refused_wrong: Share of the wrong answers of known places that were refused.
        refused_unknown: Share of the queries of unknown places that were refused.
    """

    known_queries: int
    off_map_queries: int
    unknown_queries: int
    auroc: float | None
    average_precision: float | None
    ece: float | None
    ece_adaptive: float | None
    ece_mixed: float | None
    ece_mixed_adaptive: float | None
    refused_right: float | None
    refused_wrong: float | None
    refused_unknown: float | None


def reliability(
    known: Sequence[Outcome], unknown: Sequence[Outcome], off_map: int = 0
) -> Reliability:
    """Return the metrics of the answers to queries of known and of unknown places.

    Args:
        known: The outcomes of queries of known places.
        unknown: Those of unknown places.
        off_map: How many queries are left out.
    """
    of_known, of_unknown = (
        np.array([outcome.probability for outcome in group], dtype=np.float64)
        for group in (known, unknown)
    )
    right = np.array([outcome.right for outcome in known], dtype=bool)
    both = np.concatenate([of_known, of_unknown])
    all_right = np.concatenate([right, np.zeros(len(unknown), dtype=bool)])
    mixes = bool(known) and bool(unknown)
    counts = np.array([len(known), len(unknown)])
    weight = np.repeat(1.0 / np.maximum(1, counts), counts)
    ece = _calibration_errors(of_known, right)
    mixed = _calibration_errors(both, all_right, weight) if mixes else (None, None)
    return Reliability(
        known_queries=len(known),
        off_map_queries=off_map,
        unknown_queries=len(unknown),
        auroc=auroc(of_known, of_unknown) if mixes else None,
        average_precision=(
            precision_recall(both, np.arange(len(both)) < len(known), len(known)).average_precision
            if mixes
            else None
        ),
        ece=ece[0],
        ece_adaptive=ece[1],
        ece_mixed=mixed[0],
        ece_mixed_adaptive=mixed[1],
        refused_right=_refused([outcome for outcome in known if outcome.right]),
        refused_wrong=_refused([outcome for outcome in known if not outcome.right]),
        refused_unknown=_refused(unknown),
    )


def _calibration_errors(
    probability: FloatArray, right: BoolArray, weight: FloatArray | None = None
) -> tuple[float | None, float | None]:
    """Return the error over bins of equal width, and over bins of equal count."""
    if not len(probability):
        return None, None
    wide, adaptive = (
        expected_calibration_error(probability, right, adaptive=adaptive, weight=weight)
        for adaptive in (False, True)
    )
    return wide, adaptive


def _refused(group: Sequence[Outcome]) -> float | None:
    return float(np.mean([not outcome.localized for outcome in group])) if group else None
