"""How far each query is from the nearest place, and the recall of those that have one."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from core.arrays import BoolArray, FloatArray, IntArray
from core.evaluation.metrics import rate
from core.scans.pose import is_known


def nearest_place(
    places: FloatArray, queries: FloatArray, first_excluded: IntArray | None = None
) -> tuple[IntArray, FloatArray]:
    """Return the nearest place of each query, `(Q,)`, and its distance in metres, `(Q,)`.

    The row is -1 where a query has none: where its pose is unknown, the distance is NaN then, or
    where no place that it may be compared with has a pose, the distance is infinite then.

    Args:
        places: `(K, 7)` pose rows, NaN where unknown.
        queries: `(Q, 7)` likewise.
        first_excluded: `(Q,)` a query may be compared with the rows of `places` below this one;
            with all of them without it.

    Examples:
        >>> poses = np.zeros((3, 7))
        >>> poses[:, 0], poses[:, 6] = [0.0, 20.0, 21.0], 1.0
        >>> rows, metres = nearest_place(poses, poses, np.array([0, 1, 2]))
        >>> rows.tolist(), metres.tolist()
        ([-1, 0, 1], [inf, 20.0, 1.0])
    """
    known, located = np.flatnonzero(is_known(places)), is_known(queries)
    rows = np.full(len(queries), -1)
    metres = np.where(located, math.inf, math.nan)
    if first_excluded is None or (first_excluded >= len(places)).all():
        if len(known) and located.any():
            tree = KDTree(places[known, :3])
            metres[located], found = tree.query(queries[located, :3])
            rows[located] = known[found]
        return rows, metres
    # As many places as a query may be compared with, of those that have a pose.
    counts = np.searchsorted(known, first_excluded)
    for query in np.flatnonzero(located & (counts > 0)).tolist():
        candidates = known[: counts[query]]
        apart_m = np.linalg.norm(places[candidates, :3] - queries[query, :3], axis=1)
        rows[query], metres[query] = candidates[apart_m.argmin()], apart_m.min()
    return rows, metres


def recall_within(
    answered_m: FloatArray, nearest_m: FloatArray, metres: float
) -> tuple[int, float | None]:
    """Return how many queries are findable, and which share of them has a right answer.

    A query is findable if a place is within so many metres of it; an answer is right if the place
    that it names is. Answers whose place has no pose cannot be checked and do not count.

    Args:
        answered_m: `(Q,)` the distance of the place of each answer, NaN where unknown.
        nearest_m: `(Q,)` the distance of the nearest place, NaN where unknown.
        metres: The tolerance.

    Examples:
        >>> nearest_m = np.array([0.5, 2.0, 80.0])
        >>> recall_within(np.array([0.5, 30.0, 90.0]), nearest_m, 3.0)
        (2, 0.5)
    """
    findable: BoolArray = (nearest_m <= metres) & np.isfinite(answered_m)
    return int(findable.sum()), rate(answered_m[findable] <= metres)


def recalls_within(
    answered_m: FloatArray, nearest_m: FloatArray, tolerances_m: Sequence[float]
) -> tuple[dict[float, int], dict[float, float | None]]:
    """Return both figures of `recall_within` for several tolerances, each by tolerance.

    Args:
        answered_m: As for `recall_within`.
        nearest_m: As for `recall_within`.
        tolerances_m: The tolerances.
    """
    found = {metres: recall_within(answered_m, nearest_m, metres) for metres in tolerances_m}
    return (
        {metres: findable for metres, (findable, _) in found.items()},
        {metres: recall for metres, (_, recall) in found.items()},
    )
