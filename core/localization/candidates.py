"""Which scans of the map come into question for a query, and what to think of them."""

import math
from dataclasses import dataclass, replace

import numpy as np

from core.arrays import BoolArray
from core.confidence.calibration import Calibration
from core.confidence.places import away_from, close_along_m
from core.confidence.spread import Deviation, along_spread_m
from core.confidence.verdict import Refusal, Verdict, judge
from core.encodings.model import Neighbours, Search
from core.localization.priors import Prior, nearest_within
from core.mapping.tensormap import TensorMap

_WEIGHED = 32  # nearest scans among which a prior chooses
_FAR_BETTER = -math.log(0.0027)  # as much as hints that are off by three sigma are unlikely


@dataclass(frozen=True)
class Candidates:
    """What a search gave.

    Attributes:
        matches: The k best, best first; at least one.
        away: The best away from the winner, none or one.
        share: Of the map's scans, how many came into question.
        outside: What is nearest in the whole map, where hints exclude it.
        hinted: Whether `matches` are within the hints; if nothing is, they are of the whole map.
    """

    matches: Neighbours
    away: Neighbours
    share: float
    outside: "Candidates | None" = None
    hinted: bool = True

    @property
    def ratio(self) -> float | None:
        """Distance of the winner over that of the runner-up, at most 1."""
        if not len(self.away):
            return None
        if self.away.distances[0] == 0.0:
            return 1.0  # both places are exactly the query
        return min(1.0, float(self.matches.distances[0] / self.away.distances[0]))

    def judge(
        self,
        calibration: Calibration | None,
        min_probability: float | None,
        occupied_cells: int | None,
    ) -> Verdict:
        """Say whether the best of them is an answer.

        `outside_prior` it is not if nothing lies within the hints, or if the nearest scan of the
        whole map would be an answer without them and fits far better.
        """
        verdict = judge(
            calibration,
            float(self.matches.distances[0]),
            self.ratio,
            share=self.share,
            min_probability=min_probability,
            occupied_cells=occupied_cells,
        )
        if not self.hinted:
            return replace(verdict, reason=Refusal.OUTSIDE_PRIOR)
        if self.outside is None or calibration is None:
            return verdict
        elsewhere = self.outside.judge(calibration, min_probability, occupied_cells)
        inside, outside = calibration.log_likelihood_ratio(
            np.array([self.matches.distances[0], self.outside.matches.distances[0]])
        )
        if elsewhere.localized and outside - inside > _FAR_BETTER:
            return replace(verdict, reason=Refusal.OUTSIDE_PRIOR)
        return verdict


def find_candidates(
    tensor_map: TensorMap, search: Search, k: int, prior: Prior | None = None
) -> Candidates:
    """Return the k best matches and the runner-up of a search, within a prior if there is one."""
    searched = np.isin(tensor_map.model.segment_of_scan, search.segments)
    if prior is None:
        matches = search.nearest(k)
        away = search.nearest(1, away_from(tensor_map.trajectory, int(matches.rows[0])))
        return Candidates(matches, away, float(searched.mean()))
    whole = find_candidates(tensor_map, search, k)
    matches = _weighed(tensor_map, search, max(k, _WEIGHED), prior)[:k]
    if not len(matches):
        return replace(whole, hinted=False)
    away_mask = away_from(tensor_map.trajectory, int(matches.rows[0]))
    away = _weighed(tensor_map, search, _WEIGHED, prior, away_mask)
    return Candidates(
        matches,
        away[:1],
        prior.share * float(searched[prior.rows].mean()),
        None if prior.allows(whole.matches)[0] else whole,
    )


def _weighed(
    tensor_map: TensorMap,
    search: Search,
    k: int,
    prior: Prior,
    among: BoolArray | None = None,
) -> Neighbours:
    """Return the nearest within a prior, the likeliest first; without calibration the nearest."""
    found = nearest_within(search, k, prior, among)
    calibration = tensor_map.calibration
    if calibration is None:
        return found
    likely = calibration.log_likelihood_ratio(found.distances) + prior.log_weight(found)
    return found[np.argsort(-likely, kind="stable")]


def deviation_of(tensor_map: TensorMap, search: Search, found: Neighbours) -> Deviation | None:
    """Return how far off the first match may be if it is right, `None` where not known."""
    calibration = tensor_map.calibration
    if calibration is None or calibration.spread is None:
        return None
    near = close_along_m(tensor_map.trajectory, int(found.rows[0]))
    if near is None:
        return None
    rows, along_m = near
    asked = np.zeros(len(tensor_map), dtype=bool)
    asked[rows] = True
    distances = search.distances(asked)[rows]
    compared = np.isfinite(distances)
    fits = calibration.log_likelihood_ratio(distances[compared])
    return calibration.spread.deviation(
        float(found.distances[0]), along_spread_m(along_m[compared], fits)
    )
