"""One query in several maps: the best match in any of them, and the runner-up away from it.

Among more places a wrong one is nearer by chance, and so is the runner-up: a probability that takes
its ratio from all maps falls as their number grows (docs/decisions/0035-where-among-all-maps.md).
Frames of different maps are not compared: a match in another map is away from the best one, also
where the maps overlap.
"""

import math
from collections.abc import Sequence
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
class LocalizationAmong:
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


def localize_among(
    searched: Sequence[SearchedMap],
    k: int = 1,
    *,
    min_probability: float | None = None,
) -> LocalizationAmong:
    """Return the best match of a query in several maps.

    Distances of one measure are compared as they are; those of several, as a calibrated map takes
    them: by the log-likelihood ratio of a scan at such a distance.

    Args:
        searched: At least one map.
        k: Number of matches.
        min_probability: Least probability to accept; the map's threshold by default.

    Raises:
        InvalidParameters: If there is no map, `k` is below 1, or `min_probability` is not within
            0..1.
    """
    require_at_least(1, k=k)
    if not searched:
        raise InvalidParameters("no map is searched, wanted at least one")
    found = [find_candidates(one.tensor_map, one.search, k) for one in searched]
    alike = len({_measure(one) for one in searched}) == 1
    far = [
        _far(one, of_map.matches, alike=alike) for one, of_map in zip(searched, found, strict=True)
    ]
    nearest = sorted(
        (float(distance), number, position)
        for number, distances in enumerate(far)
        for position, distance in enumerate(distances)
    )[:k]
    _, winner, _ = nearest[0]
    best, of_best = searched[winner], found[winner]
    others = [(float(far[n][0]), n, found[n].matches) for n in range(len(found)) if n != winner]
    if len(of_best.away):
        others.append((float(_far(best, of_best.away, alike=alike)[0]), winner, of_best.away))
    second = min(others, key=lambda other: other[:2], default=None)
    ratio = None
    if second is not None:
        ratio = _ratio(best, of_best, searched[second[1]], second[2], alike=alike)
    decision = decide(
        best.tensor_map.calibration_of(best.search),
        float(of_best.matches.distances[0]),
        ratio,
        share=of_best.share,
        evidence=of_best.evidence,
        min_probability=min_probability,
        occupied_cells=best.occupied_cells,
    )
    return LocalizationAmong(
        tuple(_match(searched[n], found[n].matches, position) for _, n, position in nearest),
        None if second is None else _match(searched[second[1]], second[2], 0),
        decision,
        deviation_of(best.tensor_map, best.search, of_best.matches),
        ratio,
    )


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
