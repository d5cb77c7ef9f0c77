"""The emission: the likelihood of one observation's distances at each scan of the map."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import BoolArray, Float32Array, FloatArray
from core.confidence.calibration import Calibration, distance_ratio
from core.confidence.places import away_from
from core.confidence.rescaling import Rescaling
from core.encodings.search import Search, nearest
from core.mapping.own_place import own_place
from core.mapping.tensormap import TensorMap
from core.scans.trajectory import Trajectory

_SAMPLED = 32  # scans of the map that are compared with all others
_ELSEWHERE_M = 50.0  # a street is alike along itself, and so says little of other places
_RARE = 0.1  # quantile: a tenth of the map's scans have one elsewhere that is as near
_RESOLVED = 0.5  # of the change from one scan to the next
_STEPS_AWAY = 10.0  # changes from scan to scan, assumed a metre each, to a scan `AWAY_M` away
_TINIEST = 1e-6  # of the decision distance: 0 has no logarithm; a whole view has `_MOST` before
_SLOPE = 4.0  # twice as far from the query is 16 times less likely
_MOST = 8.0  # nats: the most that a single observation changes the belief
_UNLIKELY = 1e-3, 1e-5  # belief in a scan that is not compared; the second if these matter
_FEW = 256  # scans that are compared exactly in less time than all are compared less exactly
_NEAREST = 8  # scans that may be nearest and are compared wherever they are
_NEGLIGIBLE = 1e-3  # share of the belief in scans that were not compared


@dataclass(frozen=True)
class OwnDistances:
    """Distances between a map's own scans: what is near, and what is too far.

    A query from outside the map has a nearest scan too. Its distance is estimated by the nearest
    scan elsewhere of each of the map's own scans, that of a query from within it by the nearest one
    beside it. In a map without a calibration their ratio takes its place.

    Attributes:
        resolution: Half the change from a scan of the map to the next; above 0. Smaller differences
            are not significant.
        decision_distance: The distance of the nearest scan at which being on the map is as likely
            as not; above 0. Where the map has no scans elsewhere, ten times the change from scan to
            scan.
        evidence: The evidence of the map's own scans as queries, see `Search`; above 0. Less for a
            sensor that never sees all around.
    """

    resolution: float
    decision_distance: float
    evidence: float = 1.0

    def log_likelihood_ratio(self, distances: FloatArray) -> FloatArray:
        """Return a ratio that falls with the distance and is 0 at the decision distance."""
        decision = self.decision_distance
        return np.asarray(_SLOPE * np.log(decision / np.maximum(distances, _TINIEST * decision)))

    @classmethod
    def of_map(cls, tensor_map: TensorMap) -> "OwnDistances":
        """Return those of a map, from some of its signatures against all.

        Of each stand one: scans of one place are nearer each other than any query is. It is the
        last, which is followed by another place.
        """
        model, trajectory = tensor_map.model, tensor_map.trajectory
        # Signatures of two segments may not be comparable.
        follows = (np.diff(trajectory.drive_of_scan) == 0) & (np.diff(model.segment_of_scan) == 0)
        places = np.unique(trajectory.stands[:, 1])
        if not follows[places[places < len(follows)]].any():  # all of it was recorded in stands
            places = np.arange(len(tensor_map))
        sampled = np.unique(np.linspace(0, len(places) - 1, _SAMPLED).astype(np.int64))
        rows = places[sampled].tolist()
        found: list[tuple[float, ...]] = []
        queries = model.own_queries(rows, tensor_map.revision)
        for row, signatures in zip(rows, queries, strict=True):
            search = model.search(signatures)
            _, here = own_place(trajectory, row)
            elsewhere, away = away_from(trajectory, row, _ELSEWHERE_M), away_from(trajectory, row)
            following = np.zeros(len(tensor_map), np.bool_)
            following[row + 1 : row + 2] = follows[row : row + 1]
            of_sets = search.nearest_distances([here, elsewhere, away, following])
            found.append((*of_sets, search.evidence))
        beside, far, farther, steps, evidence = np.array(found).T
        change, near = _quantile(steps, 0.5), _quantile(beside, 1.0 - _RARE)
        decision = _half_way(near, _quantile(far, _RARE))
        if decision is None:  # all of the map is within so many metres
            decision = _half_way(near, _quantile(farther, _RARE))
        if decision is None:
            decision = _STEPS_AWAY * (change or 1.0)
        resolution = decision if change is None else min(_RESOLVED * change, decision)
        return cls(resolution, decision, float(np.median(evidence)) or 1.0)


def _quantile(distances: FloatArray, share: float) -> float | None:
    """Return a quantile of the distances that are known and above 0, `None` without any."""
    known = distances[(distances > 0.0) & (distances < np.inf)]
    return float(np.quantile(known, share)) if len(known) else None


def _half_way(beside: float | None, elsewhere: float | None) -> float | None:
    """Return what is half-way between two distances, in their logarithms.

    Where scans beside are no nearer than those elsewhere, as in a map of few scans, the latter.
    """
    if elsewhere is None or beside is None or beside >= elsewhere:
        return elsewhere
    return math.sqrt(beside * elsewhere)


@dataclass(frozen=True)
class Emission:
    """The likelihood of an observation at each scan of the map, and outside of it.

    Whether the vehicle is on the map follows from two things that a repeated error moves
    differently, in equal parts: the likelihood ratio of the nearest scan, less that of the decision
    distance, as the nearest of thousands is near by chance; and the odds that a fix by this
    observation is right, which know the runner-up. A view that sees less than the map's own scans
    counts less. In a calibrated map both are of the map as a whole, so that their mean is that of
    all scans, of which each stand is one: of the nearest of many the likelihood is as many times
    larger, at most `_MOST` in all. An observation like the one before has the same nearest scan
    again, on the map or not: that it is one of many counts as far as the two are independent.

    Which scan it is follows from the distances relative to the nearest one; consecutive
    observations have similar errors, so that these weights are lower than the calibrated ones.

    Attributes:
        calibration: The map's, `None` without one: then `own` takes its place, which has no odds.
        own: Distances between the map's own scans.
        trajectory: The map's.
    """

    calibration: Calibration | None
    own: OwnDistances
    trajectory: Trajectory

    def likelihood(
        self,
        distances: FloatArray,
        evidence: float = 1.0,
        ratio: float | None = None,
        exact: float | None = None,
        independence: float = 1.0,
    ) -> FloatArray:
        """Return the likelihood at each scan, `(K,)`, relative to that of being elsewhere.

        Args:
            distances: `(K,)`, infinite for scans that were not compared.
            evidence: The evidence of their search.
            ratio: The ratio of the nearest one's distance to the runner-up's, `None` without one.
            exact: The distance of the nearest one, where `distances` are estimates.
            independence: `StationaryDetector.independence` of the observation, 0..1.
        """
        nearest = float(distances.min())
        if math.isinf(nearest):
            return np.ones(len(distances))
        own = self.own
        on_map = self._on_map(nearest if exact is None else exact, evidence, ratio)
        farther = (distances + own.resolution) / (nearest + own.resolution)
        relative = np.exp(-np.minimum(_SLOPE * np.log(farther), _MOST))
        if self.calibration is not None:
            compared = np.where(np.isfinite(distances), relative, 0.0)
            of_stands = np.maximum.reduceat(compared, self.trajectory.first_of_stands)
            on_map -= independence * math.log(of_stands[of_stands > 0.0].mean())
        return np.asarray(math.exp(min(max(on_map, -_MOST), _MOST)) * relative)

    def _on_map(self, nearest: float, evidence: float, ratio: float | None) -> float:
        """Return the evidence, in nats, that the vehicle is on the map."""
        share = min(evidence / self._own_evidence, 1.0)
        is_near = share * self._log_ratio(nearest) - self._log_ratio_at_decision
        if self.calibration is None:
            return is_near
        log_odds = self.calibration.log_odds(nearest, ratio)
        is_right = self.calibration.relative_evidence(evidence) * log_odds
        return (is_near + is_right) / 2.0

    @cached_property
    def _own_evidence(self) -> float:
        # Stored signatures do not say how far their scans see, which a calibration knows.
        return min(self.own.evidence, (self.calibration or self.own).evidence)

    def _log_ratio(self, distance: float) -> float:
        return float((self.calibration or self.own).log_likelihood_ratio(np.array(distance)))

    @cached_property
    def _log_ratio_at_decision(self) -> float:
        return self._log_ratio(self.own.decision_distance)

    def of_search(
        self,
        search: Search,
        before: FloatArray,
        rescaling: Rescaling | None = None,
        independence: float = 1.0,
    ) -> FloatArray:
        """Return the likelihood of a query at each scan, `(K,)`, as exact as a belief needs it.

        If most of the belief is in few scans, these and those that may be the nearest are compared.
        The others are taken to be as near as they may be. If they could then hold more than a
        thousandth of the belief, more scans are compared, and at last all. So they are unless the
        vehicle is surely on the map: whether it is depends on the runner-up and on how many scans
        are nearly as near.

        Args:
            search: The query's.
            before: `(K,)` belief in each scan before the observation.
            rescaling: The rescaling of the query's distances, if it has fewer numbers than the
                map's own.
            independence: As in `likelihood`.
        """
        rescaled = rescaling.of if rescaling else np.asarray

        def likelihood(distances: FloatArray, runner_up: float) -> FloatArray:
            ratio = None
            if math.isfinite(runner_up):
                ratio = distance_ratio(float(distances.min()), runner_up)
            return self.likelihood(
                rescaled(distances), search.evidence, ratio, independence=independence
            )

        few = np.count_nonzero(before > _UNLIKELY[0]) <= _FEW
        least = search.least_distances() if few else None
        if least is not None:
            of_few = self._of_few(search, before, least, likelihood)
            if of_few is not None:
                return of_few
        if search.is_estimated:
            return self._of_estimates(search, rescaled, independence)
        distances = search.distances_for_belief()
        return likelihood(distances, self._runner_up(distances, int(distances.argmin())))

    def _of_few(
        self,
        search: Search,
        before: FloatArray,
        least: FloatArray | Float32Array,
        likelihood: Callable[[FloatArray, float], FloatArray],
    ) -> FloatArray | None:
        """Return the likelihood by few exact distances, `None` if these are not exact enough.

        Args:
            search: The query's.
            before: `(K,)` belief in each scan before the observation.
            least: `(K,)` the least distance that each scan may have.
            likelihood: Returns it for all distances, `(K,)`, and that of the runner-up.
        """
        may_be_nearest, compared = nearest(least, _NEAREST), 0
        for unlikely in _UNLIKELY:
            likely = before > unlikely
            likely[may_be_nearest] = True
            rows = np.flatnonzero(likely)
            if not compared < len(rows) <= _FEW:
                return None
            compared = len(rows)
            exact = search.distances_of(rows)
            distances = np.maximum(least, exact.min(), dtype=np.float64)
            distances[rows] = exact
            found = likelihood(distances, self._runner_up(distances, int(rows[exact.argmin()])))
            after = before * found
            within = after.sum()
            if within - after[rows].sum() <= _NEGLIGIBLE * within:
                surely_on_map = 1.0 - before.sum() <= _NEGLIGIBLE * within
                return found if surely_on_map or self.calibration is None else None
        return None

    def _of_estimates(
        self, search: Search, rescaled: Callable[[FloatArray], FloatArray], independence: float
    ) -> FloatArray:
        """Return the likelihood of a query at each scan where all distances are estimates.

        These say which scan it is, and how many are nearly as near. Whether it is on the map
        follows from the exact distances of the nearest scan and of its runner-up: the map is
        calibrated on such.
        """
        found = search.nearest(1)
        nearest, away = float(found.distances[0]), self._away_from(int(found.rows[0]))
        ratio = None
        if away.any():
            ratio = distance_ratio(nearest, float(search.nearest(1, away).distances[0]))
        distances, exact = rescaled(search.distances_for_belief()), rescaled(np.array(nearest))
        return self.likelihood(distances, search.evidence, ratio, float(exact), independence)

    def _runner_up(self, distances: FloatArray, row: int) -> float:
        """Return the distance of the runner-up of a row, infinite without one."""
        return float(distances[self._away_from(row)].min(initial=np.inf))

    def _away_from(self, row: int) -> BoolArray:
        """Return where the runner-up of a row can be, `(K,)`; nowhere in an uncalibrated map."""
        if self.calibration is None:
            return np.zeros(len(self.trajectory), np.bool_)
        return away_from(self.trajectory, row)

    @classmethod
    def of_map(cls, tensor_map: TensorMap) -> "Emission":
        """Return the emission of a map, by its calibration where it has one."""
        return cls(tensor_map.calibration, OwnDistances.of_map(tensor_map), tensor_map.trajectory)
