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

import numpy as np

from core.arrays import FloatArray
from core.confidence.decision import Decision, decide
from core.confidence.spread import Deviation
from core.encodings.distance import Distance
from core.encodings.model import Neighbours, Search
from core.errors import InvalidParameters
from core.localization.candidates import Candidates, deviation_of, distance_ratio, find_candidates
from core.localization.match import Match, match_at
from core.mapping.estimate import share_left
from core.mapping.tensormap import TensorMap
from core.numbers import require_at_least

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
    """

    name: str
    revision: str
    match: Match


@dataclass(frozen=True)
class AllMapsLocalization:
    """The answer to one query in several maps.

    Attributes:
        matches: The nearest scans of all maps, nearest first by what is left of their distances;
            at least one. Those of one map are in the order of its own answer.
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


def localize_in_maps(
    searched: Iterable[SearchedMap],
    k: int = 1,
    *,
    min_probability: float | None = None,
    other_places: int = 0,
) -> AllMapsLocalization:
    """Return the best match of a query in several maps.

    Distances of one measure are compared by what is left of them (`share_left`); those of several,
    as a calibrated map takes them: by the log-likelihood ratio of a scan at such a distance.

    Args:
        searched: The maps, at least one; those that cannot be in the answer are not kept.
        k: Number of matches.
        min_probability: Least probability to accept; the map's threshold by default.
        other_places: How many scans were searched in maps that are not among these, as in an index.

    Raises:
        InvalidParameters: If there is no map, `k` is below 1, or `min_probability` is not within
            0..1.
    """
    require_at_least(1, k=k)
    found: list[_Found] = []
    measures = set()
    places = other_places
    for number, searched_map in enumerate(searched):
        places += len(searched_map.tensor_map)
        measures.add(_measure(searched_map))
        candidates = find_candidates(searched_map.tensor_map, searched_map.search, k)
        share = _share_left(searched_map, candidates.matches)
        found.append(_Found(number, searched_map, candidates, share))
        orders = (False,) if len(measures) > 1 else (True, False)
        needed = {number for alike in orders for number in _needed(found, k, alike=alike)}
        found = [each for each in found if each.number in needed]
    if not found:
        raise InvalidParameters("no map is searched, wanted at least one")
    alike = len(measures) == 1
    of_number = {each.number: each for each in found}
    nearest = _nearest(found, k, alike=alike)
    winner = of_number[nearest[0][1]]
    best, of_best = winner.searched, winner.candidates
    # The runner-up is the one that says most against the best match. A map that has none of its
    # own was not calibrated on such, and its answer could become surer than in the map alone.
    power = 1.0
    if len(of_best.away):
        power += _POWER * math.log10(places / len(best.tensor_map))
    others = [
        _Other(ratio, None if ratio is None else ratio**power, of_map)
        for of_map in sorted(found, key=lambda each: float(each.far(alike=alike)[0]))
        if of_map is not winner
        for ratio in [_ratio(winner, of_map, alike=alike)]
    ]
    if len(of_best.away):
        others.insert(0, _Other(of_best.ratio, of_best.ratio, winner))
    second = max(others, key=lambda other: other.counted_ratio or 0.0, default=None)
    decision = decide(
        best.tensor_map.calibration_of(best.search),
        float(of_best.matches.distances[0]),
        None if second is None else second.counted_ratio,
        share=of_best.share,
        evidence=of_best.evidence,
        min_probability=min_probability,
        occupied_cells=best.occupied_cells,
    )
    return AllMapsLocalization(
        tuple(
            _match(of_number[number].searched, of_number[number].candidates.matches, position)
            for _, number, position in nearest
        ),
        None if second is None else _runner_up(second.of_map, winner),
        decision,
        deviation_of(best.tensor_map, best.search, of_best),
        None if second is None else second.ratio,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """One of the maps, by its number, and what was found in it.

    Attributes:
        share_left: The share left of the distances, by the best match.
    """

    number: int
    searched: SearchedMap
    candidates: Candidates
    share_left: float

    def far(self, *, alike: bool) -> FloatArray:
        """Return how unlikely the matches are, comparable between maps, `(n,)`."""
        distances = self.candidates.matches.distances
        if alike:
            return distances * self.share_left
        calibration = self.searched.tensor_map.calibration_of(self.searched.search)
        if calibration is None:
            return np.full(len(distances), math.inf)
        return -calibration.log_likelihood_ratio(distances)


@dataclass(frozen=True, eq=False)
class _Other:
    """What may be the runner-up: a match of another map, or one away from the best in its own.

    Attributes:
        ratio: The ratio of the best match to it, `None` if they cannot be compared.
        counted_ratio: The ratio that says as much in a map's calibration.
        of_map: The match's map.
    """

    ratio: float | None
    counted_ratio: float | None
    of_map: _Found


def _nearest(found: Sequence[_Found], k: int, *, alike: bool) -> list[tuple[float, int, int]]:
    """Return the nearest matches: how far each is, the number of its map, and its position."""
    return sorted(
        (float(distance), of_map.number, position)
        for of_map in found
        for position, distance in enumerate(of_map.far(alike=alike))
    )[:k]


def _needed(found: Sequence[_Found], k: int, *, alike: bool) -> set[int]:
    """Return the maps of the nearest matches and, for the runner-up, of the two nearest first."""
    first = sorted((float(of_map.far(alike=alike)[0]), of_map.number) for of_map in found)
    nearest = _nearest(found, k, alike=alike)
    return {number for _, number in first[:2]} | {number for _, number, _ in nearest}


def _match(searched: SearchedMap, found: Neighbours, position: int) -> MatchInMap:
    match = match_at(searched.tensor_map, searched.search, found, position)
    return MatchInMap(searched.name, searched.tensor_map.revision, match)


def _runner_up(of_map: _Found, winner: _Found) -> MatchInMap:
    candidates = of_map.candidates
    return _match(of_map.searched, candidates.away if of_map is winner else candidates.matches, 0)


def _measure(searched: SearchedMap) -> tuple[object, ...]:
    parameters = searched.tensor_map.parameters
    return parameters.encoding, parameters.image, parameters.distance, searched.search.verified


def _share_left(searched: SearchedMap, matches: Neighbours) -> float:
    """Return `share_left` of the best match; 1 of images and of plain distances."""
    if searched.search.verified or searched.tensor_map.parameters.distance != Distance.NORMALISED:
        return 1.0
    yaw_deg = float(matches.relative_yaw_deg[0])
    trajectory, row = searched.tensor_map.trajectory, int(matches.rows[0])
    return share_left(searched.search, trajectory, row, None if math.isnan(yaw_deg) else yaw_deg)


def _ratio(winner: _Found, other: _Found, *, alike: bool) -> float | None:
    """Return the ratio to the best match of another map; of several measures there is none."""
    if not alike:
        return None
    nearest, second = (float(each.far(alike=True)[0]) for each in (winner, other))
    return distance_ratio(nearest, second)
