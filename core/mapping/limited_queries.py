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

_SAMPLED = 64  # scans of the map
_SAMPLED_IMAGES = 128  # within little of a view a few are very near, so that means vary more
_SPREAD = 0.5  # standard deviations: docs/reference/trust-measurements.md#scans-of-little
_TURN = 23  # sectors from one scan to the next: limits of azimuth are measured all around


class LimitedSignatures:
    """Measures what distances of a map's limited signatures mean; safe to share between threads.

    What its own queries find is searched once for all limits.

    Args:
        model: The map's model, in an encoding whose queries may have limits.
        trajectory: The map's trajectory.
        revision: The map's revision.
    """

    def __init__(self, model: Model, trajectory: Trajectory, revision: str) -> None:
        self._model, self._trajectory, self._revision = model, trajectory, revision
        self._usual: dict[int, float] = {}

    def rescaling(self, limits: QueryLimits) -> Rescaling:
        """Return how distances of limited queries become distances of the map's own queries.

        Returns:
            The rescaling; one that changes nothing if no scan was recorded elsewhere.
        """
        model, by_limited, by_usual = self._model, [], []
        for row, turned, elsewhere in _sampled(self._trajectory, _SAMPLED):
            limited = model.limited_query(row, self._revision, limits, turned)
            if limited is None:
                continue
            if row not in self._usual:
                [usual] = model.own_queries([row], self._revision)
                self._usual[row] = _nearest(model, usual, elsewhere)
            by_limited.append(_nearest(model, [limited], elsewhere))
            by_usual.append(self._usual[row])
        if not by_usual:
            return Rescaling(shift=0.0, power=1.0)
        found = Rescaling.of_wrong_places(np.array(by_limited), np.array(by_usual))
        return found.weighted(limits.weight)


class LimitedScans:
    """Measures what distances of a map's limited scans mean; safe to share between threads.

    What its scans find in whole is searched once for all limits.

    Args:
        model: The model of a map that keeps small images of its scans.
        trajectory: The map's trajectory.
        calibration: The calibration of scans that are compared cell by cell.
    """

    def __init__(self, model: Model, trajectory: Trajectory, calibration: Calibration) -> None:
        self._model, self._trajectory, self._calibration = model, trajectory, calibration
        self._whole: dict[int, float | None] = {}

    def odds_gained(self, limits: QueryLimits) -> float:
        """Return how much higher the log-odds of wrong matches are of limited scans than of whole.

        Of both the mean and half a standard deviation count: the less is seen, the more these odds
        differ between scans, and those above the mean are the ones that are accepted.

        Returns:
            The difference, at least 0; as much of it as the weight of the limits says.
        """
        by_limited, by_whole = [], []
        for row, turned, elsewhere in _sampled(self._trajectory, _SAMPLED_IMAGES):
            if row not in self._whole:
                self._whole[row] = self._wrong_odds(self._model.search_own(row), elsewhere)
            whole = self._whole[row]
            limited = self._wrong_odds(self._model.search_own(row, limits, turned), elsewhere)
            if whole is not None and limited is not None:
                by_limited.append(limited)
                by_whole.append(whole)
        if not by_whole:
            return 0.0
        gained = float(np.mean(by_limited) - np.mean(by_whole))
        spread = float(np.std(by_limited) - np.std(by_whole))
        return limits.weight * max(0.0, gained + _SPREAD * spread)

    def _wrong_odds(self, search: Search | None, elsewhere: BoolArray) -> float | None:
        if search is None:
            return None
        found = search.nearest(1, elsewhere)
        away = search.nearest(1, elsewhere & away_from(self._trajectory, int(found.rows[0])))
        distance, ratio = float(found.distances[0]), None
        if len(away):
            ratio = distance_ratio(distance, float(away.distances[0]))
        return self._calibration.log_odds(distance, ratio)


def _sampled(trajectory: Trajectory, count: int) -> Iterator[tuple[int, int, BoolArray]]:
    """Yield rows of some scans, by how much limits are turned, and what was recorded elsewhere."""
    rows = np.unique(np.linspace(0, len(trajectory) - 1, count).astype(np.int64)).tolist()
    for number, row in enumerate(rows):
        elsewhere = elsewhere_from(trajectory, row)
        if elsewhere.any():
            yield row, _TURN * number, elsewhere


def _nearest(model: Model, signatures: Sequence[Signature], among: BoolArray) -> float:
    return float(model.search(signatures).nearest(1, among).distances[0])
