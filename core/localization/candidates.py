"""Candidates: the best matches and the runner-up of a search, and the decision about them."""

import math
from dataclasses import dataclass, replace

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.confidence.calibration import Calibration, distance_ratio
from core.confidence.decision import Decision, Refusal, decide
from core.confidence.places import away_from, close_along_m
from core.confidence.spread import Deviation, along_spread_m
from core.encodings.search import Neighbours, Search
from core.localization.priors import MapPrior, nearest_within
from core.mapping.tensormap import TensorMap

_WEIGHTED = 32  # nearest scans that are ranked by their prior probability
_FAR_BETTER = -math.log(0.0027)  # log-odds of priors that are off by three sigma


@dataclass(frozen=True)
class Candidates:
    """The result of a search.

    Attributes:
        matches: The k best, best first; at least one.
        away: The best away from the first match, none or one.
        share: The share of the map's places that were searched; each stand is one.
        evidence: How much distances of this search say, as `Search.evidence`.
        outside: The candidates of the whole map, if the nearest of them is outside of the priors.
            Scans without a pose are left out, unless priors need none.
        within_priors: Whether `matches` are within the priors; if no scan is, they are of the whole
            map, and the first one may lack the pose to decide it.
        close: `close_along_m` of the first match, where it is known already.
        agreeing: The candidates of the whole map, if the nearest of them is within the priors, and
            at the place of the first match.
        odds_of_signature: The logarithm of the odds of the first match by the query's signature
            alone, `None` where that is the search itself, or does not count.
    """

    matches: Neighbours
    away: Neighbours
    share: float
    evidence: float
    outside: "Candidates | None" = None
    within_priors: bool = True
    close: tuple[IntArray, FloatArray] | None = None
    agreeing: "Candidates | None" = None
    odds_of_signature: float | None = None

    @property
    def ratio(self) -> float | None:
        """Distance of the best match divided by that of the runner-up, at most 1."""
        if not len(self.away):
            return None
        return distance_ratio(float(self.matches.distances[0]), float(self.away.distances[0]))

    def decide(
        self,
        calibration: Calibration | None,
        min_probability: float | None,
        occupied_cells: int | None,
    ) -> Decision:
        """Accept or refuse the best match.

        It is refused as `outside_prior` if no scan is within the priors, or if the nearest scan of
        the whole map would be accepted without priors and matches far better. Where priors agree
        with the whole map, it is at least as probable as without them: they may leave no runner-up
        whose distance would show how clear the match is.
        """
        decision = self.decide_by(
            self.ratio, self.odds_of_signature, calibration, min_probability, occupied_cells
        )
        if self.agreeing is not None:
            without = self.agreeing.decide(calibration, min_probability, occupied_cells)
            if (without.probability or 0.0) > (decision.probability or 0.0):
                decision = without
        if not self.within_priors:
            return replace(decision, reason=Refusal.OUTSIDE_PRIOR)
        if self.outside is None or calibration is None:
            return decision
        elsewhere = self.outside.decide(calibration, min_probability, occupied_cells)
        inside, outside = calibration.log_likelihood_ratio(
            np.array([self.matches.distances[0], self.outside.matches.distances[0]])
        )
        if elsewhere.localized and outside - inside > _FAR_BETTER:
            return replace(decision, reason=Refusal.OUTSIDE_PRIOR)
        return decision

    def decide_by(
        self,
        ratio: float | None,
        odds_of_signature: float | None,
        calibration: Calibration | None,
        min_probability: float | None,
        occupied_cells: int | None,
    ) -> Decision:
        """Accept or refuse the best match by a ratio and odds that may be others than its own.

        What is known without priors or outside of them does not count.
        """
        return decide(
            calibration,
            float(self.matches.distances[0]),
            ratio,
            share=self.share,
            evidence=self.evidence,
            odds_of_signature=odds_of_signature,
            min_probability=min_probability,
            occupied_cells=occupied_cells,
        )


def find_candidates(
    tensor_map: TensorMap,
    search: Search,
    k: int,
    prior: MapPrior | None = None,
    *,
    spread: bool = False,
) -> Candidates:
    """Return the k best matches and the runner-up of a search, within a prior if there is one.

    Args:
        tensor_map: The map.
        search: The query's search.
        k: Number of matches.
        prior: What is known of the place.
        spread: Whether `deviation_of` follows, whose scans are then compared together with others.
    """
    if prior is None:
        return _of_whole_map(tensor_map, search, k, spread=spread)
    whole = _of_whole_map(tensor_map, search, k)
    matches = _most_likely(tensor_map, search, max(k, _WEIGHTED), prior)[:k]
    undecided = bool(prior.undecided[whole.matches.rows[0]])
    if not len(matches):
        return replace(whole, within_priors=undecided)
    # What is nearest without a pose may be where the prior says, and another scan elsewhere.
    shown = _of_whole_map(tensor_map, search, 1, ~prior.undecided) if undecided else whole
    row = int(matches.rows[0])
    away = away_from(tensor_map.trajectory, row)
    is_within, is_away = prior.allows(shown.matches)[0], away[shown.matches.rows[0]]
    return Candidates(
        matches,
        _most_likely(tensor_map, search, _WEIGHTED, prior, away)[:1],
        prior.share * _share(tensor_map, search, prior.rows),
        search.evidence,
        None if is_within else shown,
        agreeing=shown if is_within and not is_away else None,
        odds_of_signature=_odds_of_signature(tensor_map, search, row, away, prior),
    )


def _of_whole_map(
    tensor_map: TensorMap,
    search: Search,
    k: int,
    among: BoolArray | None = None,
    *,
    spread: bool = False,
) -> Candidates:
    """Return the k nearest scans without a prior, of all or `among` some; the runner-up is of all.

    Arguments as of `find_candidates`.
    """
    matches = search.nearest(k, among)
    row = int(matches.rows[0])
    away, close = away_from(tensor_map.trajectory, row), None
    if spread and (close := close_along_m(tensor_map.trajectory, row, away)) is not None:
        search.expect(close[0])  # before the runner-up is searched
    return Candidates(
        matches,
        search.nearest(1, away),
        _share(tensor_map, search),
        search.evidence,
        close=close,
        odds_of_signature=_odds_of_signature(tensor_map, search, row, away),
    )


def _odds_of_signature(
    tensor_map: TensorMap,
    search: Search,
    row: int,
    away: BoolArray,
    prior: MapPrior | None = None,
) -> float | None:
    """Return the logarithm of the odds of a match by the query's signature alone.

    `None` where the signature does not count beside images, is not calibrated, or has no runner-up.
    """
    calibration = tensor_map.calibration_of(search)
    if calibration is None or not calibration.counts_signature(
        search.evidence, short_reach=search.short_reach
    ):
        return None
    if (signature := search.by_signature) is None:
        return None
    of_signature = tensor_map.calibration_of(signature)
    if prior is None:
        runner_up = signature.nearest(1, away)
    else:
        runner_up = nearest_within(signature, 1, prior, away)
    if of_signature is None or not len(runner_up):
        return None
    [distance] = signature.distances_of(np.array([row])).tolist()
    return of_signature.log_odds(distance, distance_ratio(distance, float(runner_up.distances[0])))


def _share(tensor_map: TensorMap, search: Search, among: BoolArray | None = None) -> float:
    """Return the share of the places of some scans, of all without them, that is searched."""
    if len(search.segments) == tensor_map.model.segments:
        return 1.0
    searched = np.isin(tensor_map.model.segment_of_scan, search.segments)
    among = np.ones_like(searched) if among is None else among
    count = tensor_map.trajectory.count_places
    return count(searched & among) / count(among)


def _most_likely(
    tensor_map: TensorMap,
    search: Search,
    k: int,
    prior: MapPrior,
    among: BoolArray | None = None,
) -> Neighbours:
    """Return the nearest scans within a prior, most likely first; by distance if not calibrated."""
    found = nearest_within(search, k, prior, among)
    calibration = tensor_map.calibration_of(search)
    if calibration is None:
        return found
    log_odds = calibration.log_likelihood_ratio(found.distances) + prior.log_weight(found)
    return found[np.argsort(-log_odds, kind="stable")]


def deviation_of(tensor_map: TensorMap, search: Search, candidates: Candidates) -> Deviation | None:
    """Return the standard deviations of the first match if it is right, `None` if not known."""
    calibration = tensor_map.calibration_of(search)
    if calibration is None or calibration.spread is None:
        return None
    best = candidates.matches
    close = candidates.close or close_along_m(tensor_map.trajectory, int(best.rows[0]))
    if close is None:
        return None
    rows, along_m = close
    distances = search.distances_of(rows)
    compared = np.isfinite(distances)
    ratios = calibration.log_likelihood_ratio(distances[compared])
    deviation = calibration.spread.deviation(
        float(best.distances[0]), along_spread_m(along_m[compared], ratios)
    )
    return deviation.of_less(calibration.relative_evidence(search.evidence))
