"""The decision whether a match is accepted, and the reason of a refusal."""

import math
from dataclasses import dataclass
from enum import StrEnum

from core.confidence.calibration import Calibration
from core.errors import InvalidParameters


class Refusal(StrEnum):
    """Why a query was not localized."""

    UNKNOWN_PLACE = "unknown_place"
    """No scan of the map is near enough: the place is not mapped, or has changed."""
    AMBIGUOUS = "ambiguous"
    """The match is near enough, but another place is nearly as near."""
    TOO_FEW_RETURNS = "too_few_returns"
    """The image has too few occupied cells, as beside a lorry or with a half-covered sensor; or its
    view is too small to tell places apart, as narrow and short of reach."""
    OUTSIDE_PRIOR = "outside_prior"
    """No scan is within the priors, or a scan outside of them matches far better."""
    NOT_CALIBRATED = "not_calibrated"
    """A minimum probability was requested of a map without calibration."""


_LEAST_EVIDENCE = math.sqrt(0.083)
"""The evidence of a view of a twelfth of the map's own; with less, most matches are wrong:
docs/reference/trust-measurements.md#narrow-and-short-views."""


@dataclass(frozen=True)
class Decision:
    """Whether the best match is accepted.

    Attributes:
        probability: The probability that the best match is right, `None` from a map without
            calibration.
        reason: Why it is refused, `None` if it is accepted.
    """

    probability: float | None
    reason: Refusal | None

    @property
    def localized(self) -> bool:
        """Whether the match is accepted."""
        return self.reason is None


def decide(
    calibration: Calibration | None,
    distance: float,
    ratio: float | None,
    *,
    share: float = 1.0,
    evidence: float = 1.0,
    odds_of_signature: float | None = None,
    min_probability: float | None = None,
    occupied_cells: int | None = None,
) -> Decision:
    """Accept or refuse the best match of a query.

    Without a calibration there is no probability, and a match is refused only if `min_probability`
    is above 0.

    Args:
        calibration: The map's calibration.
        distance: The best match's distance.
        ratio: The ratio of that to the runner-up's distance, at most 1, `None` without one.
        share: The share of the map's places that were searched.
        evidence: How much the query's distances say, 0..1: the root of the share of cells that it
            sees. A view of less than a twelfth of what the map's own scans see is refused.
        odds_of_signature: The logarithm of the odds of the same match by the query's signature
            alone, `None` where it is not known.
        min_probability: Least probability to accept; the calibration's threshold by default.
        occupied_cells: Number of occupied cells of the query's image, `None` if the query is a
            signature.

    Raises:
        InvalidParameters: If `min_probability` is not within 0..1.
    """
    if min_probability is not None and not 0.0 <= min_probability <= 1.0:
        raise InvalidParameters(f"min_probability is {min_probability}, wanted 0..1")
    if calibration is None:
        return Decision(None, Refusal.NOT_CALIBRATED if min_probability else None)
    least = calibration.threshold if min_probability is None else min_probability
    probability = calibration.probability(distance, ratio, share, evidence, odds_of_signature)
    too_few = occupied_cells is not None and occupied_cells < calibration.least_cells
    if too_few or calibration.relative_evidence(evidence) < _LEAST_EVIDENCE:
        return Decision(probability, Refusal.TOO_FEW_RETURNS)
    if probability >= least:
        return Decision(probability, None)
    near = calibration.probability(distance, None, share, evidence) >= least
    return Decision(probability, Refusal.AMBIGUOUS if near else Refusal.UNKNOWN_PLACE)
