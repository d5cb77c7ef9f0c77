"""What distances of limited queries mean in a map, measured on its own scans.

Scans of the map are compared with all that were recorded elsewhere, with limits and without: every
match is wrong.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from core.arrays import BoolArray
from core.confidence.calibration import Calibration, distance_ratio
from core.confidence.places import away_from, elsewhere_from
from core.confidence.rescaling import Rescaling
from core.encodings.model import Model
from core.encodings.search import QueryLimits, Search
from core.encodings.signature import Signature
from core.scans.trajectory import Trajectory

_SAMPLED = 64  # scans of the map; each is searched twice
_SAMPLED_IMAGES = 128  # within little of a view a few are very near, so that means vary more
_SPREAD = 0.5  # standard deviations: docs/reference/trust-measurements.md#scans-of-little
_TURN = 23  # sectors from one scan to the next: limits of azimuth are measured all around


def rescaling_for(
    model: Model, trajectory: Trajectory, revision: str, limits: QueryLimits
) -> Rescaling:
    """Return how distances of limited signatures become distances of the map's own queries.

    Args:
        model: Of the map, in an encoding whose queries may have limits.
        trajectory: Of the map.
        revision: The map's.
        limits: Of the queries.

    Returns:
        The rescaling; one that changes nothing if no scan was recorded elsewhere.
    """
    by_limited, by_usual = [], []
    for row, turned, elsewhere in _sampled(trajectory, _SAMPLED):
        [usual] = model.own_queries([row], revision)
        limited = model.limited_query(row, revision, limits, turned)
        if limited is not None:
            by_limited.append(_nearest(model, [limited], elsewhere))
            by_usual.append(_nearest(model, usual, elsewhere))
    if not by_usual:
        return Rescaling(shift=0.0, power=1.0)
    found = Rescaling.of_wrong_places(np.array(by_limited), np.array(by_usual))
    return found.weighted(limits.weight)


def odds_gained_by(
    model: Model, trajectory: Trajectory, calibration: Calibration, limits: QueryLimits
) -> float:
    """Return how much higher the log-odds of wrong matches are of limited scans than of whole ones.

    Of both the mean and half a standard deviation count: the less is seen, the more these odds
    differ between scans, and those above the mean are the ones that are accepted.

    Args:
        model: Of the map, which keeps small images of its scans.
        trajectory: Of the map.
        calibration: Of scans that are compared cell by cell.
        limits: Of the scans.

    Returns:
        The difference, at least 0; as much of it as the weight of the limits says.
    """
    by_limited, by_whole = [], []
    for row, turned, elsewhere in _sampled(trajectory, _SAMPLED_IMAGES):
        whole, limited = model.search_own(row), model.search_own(row, limits, turned)
        if whole is not None and limited is not None:
            by_limited.append(_wrong_odds(limited, trajectory, calibration, elsewhere))
            by_whole.append(_wrong_odds(whole, trajectory, calibration, elsewhere))
    if not by_whole:
        return 0.0
    gained = float(np.mean(by_limited) - np.mean(by_whole))
    spread = float(np.std(by_limited) - np.std(by_whole))
    return limits.weight * max(0.0, gained + _SPREAD * spread)


def _sampled(trajectory: Trajectory, count: int) -> Iterator[tuple[int, int, BoolArray]]:
    """Yield rows of some scans, by how much limits are turned, and what was recorded elsewhere."""
    rows = np.unique(np.linspace(0, len(trajectory) - 1, count).astype(np.int64)).tolist()
    for number, row in enumerate(rows):
        elsewhere = elsewhere_from(trajectory, row)
        if elsewhere.any():
            yield row, _TURN * number, elsewhere


def _nearest(model: Model, signatures: Sequence[Signature], among: BoolArray) -> float:
    return float(model.search(signatures).nearest(1, among).distances[0])


def _wrong_odds(
    search: Search, trajectory: Trajectory, calibration: Calibration, elsewhere: BoolArray
) -> float:
    found = search.nearest(1, elsewhere)
    away = search.nearest(1, elsewhere & away_from(trajectory, int(found.rows[0])))
    distance, ratio = float(found.distances[0]), None
    if len(away):
        ratio = distance_ratio(distance, float(away.distances[0]))
    return calibration.log_odds(distance, ratio)
