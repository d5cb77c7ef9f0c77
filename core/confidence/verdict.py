"""Whether an answer is one, and if not, why not."""

from dataclasses import dataclass
from enum import StrEnum

from core.confidence.calibration import Calibration
from core.errors import InvalidParameters


class Refusal(StrEnum):
    """Why a query was not localized."""

    UNKNOWN_PLACE = "unknown_place"
    """Nothing in the map is near enough: the place is not mapped, or looks different now."""
    AMBIGUOUS = "ambiguous"
    """The match is near enough, but another place is nearly as near."""
    TOO_FEW_RETURNS = "too_few_returns"
    """The image is too empty to show a place; a vehicle beside a lorry, a sensor half covered."""
    OUTSIDE_PRIOR = "outside_prior"
    """What the hints allow does not fit, or there is nothing; elsewhere fits far better."""
    NOT_CALIBRATED = "not_calibrated"
    """A probability was asked for, and the map cannot tell any."""


@dataclass(frozen=True)
class Verdict:
    """What may be thought of an answer.

    Attributes:
        probability: That the best match is right, `None` of a map without calibration.
        reason: Why it is refused, `None` if it is not.
    """

    probability: float | None
    reason: Refusal | None

    @property
    def localized(self) -> bool:
        """Whether the answer is one."""
        return self.reason is None


def judge(
    calibration: Calibration | None,
    distance: float,
    ratio: float | None,
    *,
    share: float = 1.0,
    min_probability: float | None = None,
    occupied_cells: int | None = None,
) -> Verdict:
    """Judge the best match of a query.

    A map without calibration cannot tell: it refuses nothing, as it says with a probability of
    `None`, unless a probability is asked for.

    Args:
        calibration: Of the map.
        distance: Of the best match.
        ratio: To the runner-up's, at most 1, `None` without one.
        share: Of the map's scans, how many came into question.
        min_probability: Below it the answer is a refusal; the calibration's threshold by default.
        occupied_cells: Of the query's image, `None` where only a signature came.

    Raises:
        InvalidParameters: If `min_probability` is not within 0..1.
    """
    if min_probability is not None and not 0.0 <= min_probability <= 1.0:
        raise InvalidParameters(f"min_probability is {min_probability}, wanted 0..1")
    if calibration is None:
        return Verdict(None, Refusal.NOT_CALIBRATED if min_probability else None)
    wanted = calibration.threshold if min_probability is None else min_probability
    probability = calibration.probability(distance, ratio, share)
    if occupied_cells is not None and occupied_cells < calibration.least_cells:
        return Verdict(probability, Refusal.TOO_FEW_RETURNS)
    if probability >= wanted:
        return Verdict(probability, None)
    near = calibration.probability(distance, None, share) >= wanted
    return Verdict(probability, Refusal.AMBIGUOUS if near else Refusal.UNKNOWN_PLACE)
