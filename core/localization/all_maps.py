"""One query in several maps: the best match in any of them, and the runner-up away from it.

Among more places a wrong one is nearer by chance, and so is the runner-up: a probability that takes
its ratio from all maps falls as their number grows (docs/decisions/0035-where-among-all-maps.md).
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
from core.encodings.model import Neighbours, Search
from core.errors import InvalidParameters
from core.localization.candidates import Candidates, deviation_of, find_candidates
from core.localization.match import Match, match_at
from core.mapping.tensormap import TensorMap
from core.numbers import require_at_least


@dataclass(frozen=True, eq=False)
class SearchedMap:
    """A map, and the search of a query in it.

    Attributes:
        name: Of the map.
        tensor_map: The map.
        search: The query, compared with it.
        occupied_cells: Of the query's image, `None` if the query is a signature.
    """

    name: str
    tensor_map: TensorMap
    search: Search
    occupied_cells: int | None = None


@dataclass(frozen=True)
class MatchInMap:
    """A match, and the map that it is in.

    Attributes:
        name: Of the map.
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
        matches: The nearest scans of all maps, nearest first; at least one.
        runner_up: The nearest scan away from the best match, in its map or in another, `None` if
            there is none.
        decision: Whether the best match is accepted, and its probability.
        deviation: As of a `Localization`.
        ratio: Likewise.
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
) -> AllMapsLocalization:
    """Return the best match of a query in several maps.

    Distances of one measure are compared as they are; those of several, as a calibrated map takes
    them: by the log-likelihood ratio of a scan at such a distance.

    Args:
        searched: At least one map; those that cannot be in the answer are not kept.
        k: Number of matches.
        min_probability: Least probability to accept; the map's threshold by default.

    Raises:
        InvalidParameters: If there is no map, `k` is below 1, or `min_probability` is not within
            0..1.
    """
    require_at_least(1, k=k)
    found: list[_Found] = []
    measures = set()
    for number, one in enumerate(searched):
        measures.add(_measure(one))
        found.append(_Found(number, one, find_candidates(one.tensor_map, one.search, k)))
        orders = (False,) if len(measures) > 1 else (True, False)
        needed = {number for alike in orders for number in _needed(found, k, alike=alike)}
        found = [of_map for of_map in found if of_map.number in needed]
    if not found:
        raise InvalidParameters("no map is searched, wanted at least one")
    alike = len(measures) == 1
    of_number = {of_map.number: of_map for of_map in found}
    nearest = _nearest(found, k, alike=alike)
    winner = of_number[nearest[0][1]]
    best, of_best = winner.one, winner.candidates
    others = [
        (float(other.far(alike=alike)[0]), other.number, other.candidates.matches)
        for other in found
        if other is not winner
    ]
    if len(of_best.away):
        away_far = _far(best, of_best.away, alike=alike)
        others.append((float(away_far[0]), winner.number, of_best.away))
    second = min(others, key=lambda other: other[:2], default=None)
    ratio = None
    if second is not None:
        ratio = _ratio(best, of_best, of_number[second[1]].one, second[2], alike=alike)
    decision = decide(
        best.tensor_map.calibration_of(best.search),
        float(of_best.matches.distances[0]),
        ratio,
        share=of_best.share,
        evidence=of_best.evidence,
        min_probability=min_probability,
        occupied_cells=best.occupied_cells,
    )
    return AllMapsLocalization(
        tuple(
            _match(of_number[number].one, of_number[number].candidates.matches, position)
            for _, number, position in nearest
        ),
        None if second is None else _match(of_number[second[1]].one, second[2], 0),
        decision,
        deviation_of(best.tensor_map, best.search, of_best),
        ratio,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """One of the maps, by its number, and what was found in it."""

    number: int
    one: SearchedMap
    candidates: Candidates

    def far(self, *, alike: bool) -> FloatArray:
        return _far(self.one, self.candidates.matches, alike=alike)


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


def _match(one: SearchedMap, found: Neighbours, position: int) -> MatchInMap:
    match = match_at(one.tensor_map, one.search, found, position)
    return MatchInMap(one.name, one.tensor_map.revision, match)


def _measure(one: SearchedMap) -> tuple[object, ...]:
    parameters = one.tensor_map.parameters
    return parameters.encoding, parameters.image, parameters.distance, one.search.verified


def _far(one: SearchedMap, found: Neighbours, *, alike: bool) -> FloatArray:
    """Return how unlikely neighbours are, comparable between maps, `(n,)`."""
    if alike:
        return found.distances
    calibration = one.tensor_map.calibration_of(one.search)
    if calibration is None:
        return np.full(len(found), math.inf)
    return -calibration.log_likelihood_ratio(found.distances)


def _ratio(
    best: SearchedMap,
    of_best: Candidates,
    other: SearchedMap,
    second: Neighbours,
    *,
    alike: bool,
) -> float | None:
    """Return the ratio of distances; of several measures only that within the best map."""
    if not alike and other is not best:
        return of_best.ratio
    return Candidates(of_best.matches, second, of_best.share, of_best.evidence).ratio
