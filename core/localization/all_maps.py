"""One query in several maps: the best match in any of them, and the runner-up away from it.

Among more places a wrong one is nearer by chance, and so is the runner-up. Maps are calibrated on
runners-up among their own scans: the ratio to one of another map counts as a power that rises with
how many times more places were searched (docs/decisions/0035-where-among-all-maps.md).
A right place explains a query between its scans and viewpoints better than one that is alike by
chance: signatures are compared by the distance that is left there.
Frames of different maps are not compared: a match in another map is away from the best one, also
where the maps overlap.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.arrays import FloatArray
from core.confidence.calibration import distance_ratio
from core.confidence.decision import Decision
from core.confidence.spread import Covariance, Deviation
from core.encodings.distance import Distance
from core.encodings.search import Neighbours, Search
from core.errors import InvalidParameters
from core.localization.candidates import Candidates, deviation_of, find_candidates
from core.localization.match import Match, match_at
from core.mapping.estimate import share_left
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan, require_at_least, require_whole

_POWER = 0.12  # of the ratio to another map, for each factor of ten of places


@dataclass(frozen=True, eq=False)
class SearchedMap:
    """A map, and the search of a query in it.

    Attributes:
        name: The map's name.
        tensor_map: The map.
        search: The query, compared with it.
        occupied_cells: Number of occupied cells of the query's image, `None` if the query is a
            signature.
    """

    name: str
    tensor_map: TensorMap
    search: Search
    occupied_cells: int | None = None


@dataclass(frozen=True)
class MatchInMap:
    """A match, and the map that it is in.

    Attributes:
        name: The map's name.
        revision: Digest of the revision that was searched.
        match: The match.
        aside: The drives of the revision that lie beside the others.
    """

    name: str
    revision: str
    match: Match
    aside: frozenset[str] = frozenset()


@dataclass(frozen=True)
class AllMapsLocalization:
    """The answer to one query in several maps.

    Attributes:
        matches: The nearest scans of all maps, at least one: those of one measure nearest first by
            what is left of their distances, so that those of one map are in the order of its own
            answer; several measures in the order of likelihood.
        runner_up: The scan away from the best match, in its map or in another, that says most
            against it, `None` if there is none; in another map it says the less, the more places
            were searched.
        decision: Whether the best match is accepted, and its probability.
        deviation: The deviation, as in `Localization`.
        ratio: The ratio of the distances of the best match and the runner-up, as in `Localization`
            if they are in one map; else of what is left of them. `None` without one.
    """

    matches: tuple[MatchInMap, ...]
    runner_up: MatchInMap | None
    decision: Decision
    deviation: Deviation | None
    ratio: float | None

    @property
    def best(self) -> MatchInMap:
        """The best match."""
        return self.matches[0]

    @property
    def position_covariance_m2(self) -> Covariance | None:
        """Covariance of the best match's position in its map, `None` where not known."""
        pose = self.best.match.pose
        if self.deviation is None or pose is None:
            return None
        return self.deviation.covariance_m2(pose.yaw_deg)

    @property
    def heading_std_deg(self) -> float | None:
        """Standard deviation of the best match's heading, `None` where that is not estimated."""
        if self.deviation is None or self.best.match.heading_deg is None:
            return None
        return self.deviation.heading_deg


def localize_in_maps(
    searched: Iterable[SearchedMap],
    k: int = 1,
    *,
    min_probability: float | None = None,
    other_places: int = 0,
) -> AllMapsLocalization:
    """Return the best match of a query in several maps.

    Distances of one measure are compared by what is left of them (`share_left`), whichever maps of
    others there are; those of several as a calibrated map takes them: by the log-likelihood ratio
    of a scan at such a distance. Between several there is no ratio.

    Args:
        searched: The maps, at least one; those that cannot be in the answer are not kept.
        k: Number of matches.
        min_probability: Least probability to accept; the map's threshold by default.
        other_places: How many scans were searched in maps that are not among these, as in an index.

    Raises:
        InvalidParameters: If there is no map, `k` is below 1 or no whole number, or
            `min_probability` is not within 0..1.
    """
    require_whole(k=k)
    require_at_least(1, k=k)
    found: list[_Found] = []
    places = other_places
    for number, searched_map in enumerate(searched):
        places += len(searched_map.tensor_map)
        found = _kept([*found, _Found.of(number, searched_map, k)], k)
    if not found:
        raise InvalidParameters("no map is searched, wanted at least one")
    ranked = _ranked(found)
    winner = ranked[0].of_map
    best, of_best = winner.searched, winner.candidates
    second = _runner_up(ranked, places)
    return AllMapsLocalization(
        tuple(
            _match(of_map.searched, of_map.candidates.matches, position)
            for of_map, position in ranked[:k]
        ),
        None if second is None else _match(second.of_map, second.found, 0),
        _decision(winner, second, min_probability),
        deviation_of(best.tensor_map, best.search, of_best),
        None if second is None else second.ratio,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """One of the maps, by its number, and what was found in it.

    Attributes:
        left: `(n,)` of the matches: what is left of their distances, comparable in one measure.
        unlikely: `(n,)` of the matches: the negative log-likelihood ratio, comparable between
            measures; infinite in a map that is not calibrated.
    """

    number: int
    searched: SearchedMap
    candidates: Candidates
    left: FloatArray
    unlikely: FloatArray

    @classmethod
    def of(cls, number: int, searched: SearchedMap, k: int) -> "_Found":
        """Search one of the maps."""
        candidates = find_candidates(searched.tensor_map, searched.search, k)
        distances = candidates.matches.distances
        calibration = searched.tensor_map.calibration_of(searched.search)
        return cls(
            number,
            searched,
            candidates,
            distances * _share_left(searched, candidates.matches),
            np.full(len(distances), math.inf)
            if calibration is None
            else -calibration.log_likelihood_ratio(distances),
        )

    @property
    def measure(self) -> tuple[object, ...]:
        """What distances are compared of: those of equal measures are comparable."""
        parameters = self.searched.tensor_map.parameters
        verified = self.searched.search.verified
        return parameters.encoding, parameters.image, parameters.distance, verified

    @property
    def named(self) -> tuple[str, ...]:
        """The measure, to sort by."""
        return tuple(map(str, self.measure))


class _Ranked(NamedTuple):
    """A match of one of the maps, by its position there."""

    of_map: _Found
    position: int

    @property
    def order(self) -> tuple[float, int, int]:
        """The order of matches of one measure, the nearest first."""
        return float(self.of_map.left[self.position]), self.of_map.number, self.position

    @property
    def unlikely(self) -> float:
        """The match's `_Found.unlikely`."""
        return float(self.of_map.unlikely[self.position])


@dataclass(frozen=True, eq=False)
class _RunnerUp:
    """What may be the runner-up: a match of another map, or one away from the best in its own.

    Attributes:
        of_map: The match's map.
        found: The match, first.
        ratio: The ratio of the best match to it, `None` if they cannot be compared.
        counted_ratio: The ratio that says as much in a map's calibration.
    """

    of_map: SearchedMap
    found: Neighbours
    ratio: float | None
    counted_ratio: float | None


def _decision(winner: _Found, second: _RunnerUp | None, min_probability: float | None) -> Decision:
    """Accept or refuse the best match, by the less probable of two answers.

    One is that of its map alone. The other has the runner-up among all maps, and by images only: by
    signature none is searched in another map.
    """
    of_map, found = winner.searched, winner.candidates
    calibration = of_map.tensor_map.calibration_of(of_map.search)
    alone = found.decide(calibration, min_probability, of_map.occupied_cells)
    if second is None or second.of_map is of_map:
        return alone
    decision = found.decide_by(
        second.counted_ratio, None, calibration, min_probability, of_map.occupied_cells
    )
    return min(alone, decision, key=lambda of: of.probability or 0.0)


def _by_measure(found: Sequence[_Found]) -> list[list[_Ranked]]:
    """Return the matches of each measure, nearest first."""
    measures: dict[tuple[object, ...], list[_Ranked]] = {}
    for of_map in found:
        matches = measures.setdefault(of_map.measure, [])
        matches += [_Ranked(of_map, position) for position in range(len(of_map.left))]
    return [sorted(matches, key=lambda match: match.order) for matches in measures.values()]


def _kept(found: Sequence[_Found], k: int) -> list[_Found]:
    """Return the maps that may be in the answer, whichever follow.

    Of each measure these are the maps of the k nearest matches, for the runner-up two, and that of
    the likeliest of the other matches: the k are ranked as at least as likely.
    """
    kept: set[int] = set()
    for matches in _by_measure(found):
        maps = list(dict.fromkeys(of_map.number for of_map, _ in matches))
        likeliest = min(matches[k:], key=lambda match: match.unlikely, default=matches[0])
        kept.update(maps[:2], (of_map.number for of_map, _ in (*matches[:k], likeliest)))
    return [of_map for of_map in found if of_map.number in kept]


def _ranked(found: Sequence[_Found]) -> list[_Ranked]:
    """Return all matches, best first.

    Those of one measure stay in its order: a match is as likely as the likeliest of those that are
    not nearer. So a map without calibration has its place among those that have one. Between
    measures of which none has, nothing can be compared: they are in the order of their names,
    whatever that of the maps is.
    """
    ranked = []
    for matches in sorted(_by_measure(found), key=lambda of_measure: of_measure[0].of_map.named):
        unlikely = np.array([match.unlikely for match in matches])
        least = np.minimum.accumulate(unlikely[::-1])[::-1]
        ranked += list(zip(least.tolist(), matches, strict=True))
    ranked.sort(key=lambda rank: rank[0])
    return [match for _, match in ranked]


def _runner_up(ranked: Sequence[_Ranked], places: int) -> _RunnerUp | None:
    """Return the match away from the best one that says most against it, `None` if there is none.

    Args:
        ranked: All matches, best first.
        places: How many scans were searched.
    """
    winner = ranked[0].of_map
    away = winner.candidates.away
    own, power = None, 1.0
    # A map that has no runner-up of its own was not calibrated on such, and its answer could become
    # surer than in the map alone.
    if len(away):
        own_ratio = winner.candidates.ratio
        own = _RunnerUp(winner.searched, away, own_ratio, own_ratio)
        power += _POWER * math.log10(places / len(winner.searched.tensor_map))
    others = list(dict.fromkeys(of_map for of_map, _ in ranked if of_map is not winner))
    alike = next((of_map for of_map in others if of_map.measure == winner.measure), None)
    if alike is None:
        if own is not None or not others:
            return own
        return _RunnerUp(others[0].searched, others[0].candidates.matches, None, None)
    ratio = distance_ratio(float(winner.left[0]), float(alike.left[0]))
    other = _RunnerUp(alike.searched, alike.candidates.matches, ratio, ratio**power)
    if own is not None and (own.counted_ratio or 0.0) >= ratio**power:
        return own
    return other


def _match(searched: SearchedMap, found: Neighbours, position: int) -> MatchInMap:
    searched_map = searched.tensor_map
    match = match_at(searched_map, searched.search, found, position)
    return MatchInMap(searched.name, searched_map.revision, match, searched_map.drives_aside)


def _share_left(searched: SearchedMap, matches: Neighbours) -> float:
    """Return `share_left` of the best match; 1 of images and of plain distances."""
    if searched.search.verified or searched.tensor_map.parameters.distance != Distance.NORMALISED:
        return 1.0
    yaw_deg = none_if_nan(matches.relative_yaw_deg[0])
    trajectory, row = searched.tensor_map.trajectory, int(matches.rows[0])
    return share_left(searched.search, trajectory, row, yaw_deg)
