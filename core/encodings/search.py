"""A query's search through the scans of a map, and what it finds."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.projection.probe import Displacement
from core.projection.visibility import View

_FEW = 256  # distances that are sorted as fast as the nearest are found


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The nearest scans of a search, nearest first.

    Attributes:
        rows: `(n,)` their rows in the map.
        distances: `(n,)` between the signatures.
        relative_yaw_deg: `(n,)` of the query to each scan, counter-clockwise, -180..180; NaN where
            the encoding does not estimate it.
        lateral_m: `(n,)` lateral offset of the query from each scan, NaN likewise.
    """

    rows: IntArray
    distances: FloatArray
    relative_yaw_deg: FloatArray
    lateral_m: FloatArray

    @classmethod
    def of_distances(cls, rows: IntArray, distances: FloatArray) -> "Neighbours":
        """Return neighbours of which only the distance is known."""
        unknown = np.full(len(rows), np.nan)
        return cls(rows, distances, unknown, unknown)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, chosen: slice | IntArray | BoolArray) -> "Neighbours":
        return Neighbours(*(values[chosen] for values in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """A query, and what it would be from every virtual viewpoint of some scans.

    As real numbers, whose inner products are those that the encoding compares.

    Attributes:
        query: `(d,)`.
        renderings: `(3, n, D, d)` in the heading of the query, and `step_deg` before and after it.
        step_deg: The step of headings, so small that a parabola gives those between.
        lateral_m: `(D,)` how far to the left of the scans each viewpoint is, rising.
    """

    query: FloatArray
    renderings: FloatArray
    step_deg: float
    lateral_m: FloatArray


@dataclass(frozen=True)
class QueryLimits:
    """What a query is limited to beside those that calibrate its map: it distinguishes places less.

    Attributes:
        ranks: `(r1, r2)` numbers that are compared.
        view: What its scan saw, in a few classes: of hidden sectors the number counts.
        weight: How much of what is measured of such queries applies, in logarithms, 0..1.
    """

    ranks: tuple[int, int]
    view: View
    weight: float = 1.0


class Search(ABC):
    """One query, ready to be compared with the scans of a map.

    Attributes:
        segments: The segments that are searched, rising.
        verified: Whether distances are of images too, and not of signatures alone.
        evidence: How much distances say of whether a match is right, beside those that calibrate a
            map, 0..1.
        limits: The limits of a query that has or sees less than those that calibrate a map, `None`
            of others.
        short_reach: Whether the query is of a short reach, `View.has_short_reach`.
    """

    segments: tuple[int, ...]
    verified: ClassVar[bool] = False
    evidence: float = 1.0
    limits: QueryLimits | None = None
    short_reach: bool = False

    @property
    def is_estimated(self) -> bool:
        """Whether `distances_for_belief` are estimates, which may all be too small or too large."""
        return False

    @property
    def by_signature(self) -> "Search | None":
        """The same query by its signature alone, where images are compared too; else `None`."""
        return None

    @abstractmethod
    def nearest(self, k: int, among: BoolArray | None = None) -> Neighbours:
        """Return the `k` nearest scans, at most as many as there are.

        Args:
            k: The number of scans, at least 1.
            among: `(K,)` which rows of the map are searched; all of them without it.
        """

    @abstractmethod
    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return the exact distance of each scan, `(K,)`, that of its nearest rendering.

        Infinite where a scan is not in `among`, or is not compared by this query.

        Args:
            among: `(K,)` which rows are compared; all of them without it.
        """

    def nearest_distances(self, sets: Sequence[BoolArray]) -> list[float]:
        """Return the exact distance of the nearest scan of each of some sets, infinite without one.

        Args:
            sets: `(K,)` which rows each of them has.
        """
        return nearest_of_sets(self.distances(), sets)

    def distances_for_belief(self) -> FloatArray:
        """Return the distance of each scan, `(K,)`, as exact as a track needs it.

        Exact unless an encoding has something cheaper: each observation needs those of all scans.
        """
        return self.distances()

    def least_distances(self) -> FloatArray | Float32Array | None:
        """Return about the least distance that each scan may have, `(K,)`.

        `None` unless an encoding knows them in a fraction of the time of distances.
        """
        return None

    def distances_of(self, rows: IntArray) -> FloatArray:
        """Return the exact distance of some scans, `(n,)`, infinite where one is not compared."""
        return self.distances()[rows]

    def expect(self, rows: IntArray) -> None:
        """Note scans of which `distances_of` will be called, before others are compared."""
        return

    def viewpoints(self, rows: IntArray, relative_yaw_deg: FloatArray) -> Viewpoints | None:
        """Return all renderings of some scans, `None` if they have only one.

        Between them the pose of a query is estimated.

        Args:
            rows: `(n,)`.
            relative_yaw_deg: `(n,)` of the query to each scan, counter-clockwise.
        """
        return None

    def displacement(self, row: int) -> Displacement | None:
        """Return how far the query is ahead of a scan and to its left, and its relative yaw.

        `None` of a search that does not compare images.
        """
        return None


@dataclass(frozen=True, eq=False)
class DistanceSearch(Search):
    """A search of which all distances are known.

    Attributes:
        rows: `(n,)` rows of the segments' scans, rising.
        distances_of_rows: `(n,)` in the Frobenius norm.
        scans: K, how many the map has.
    """

    segments: tuple[int, ...]
    rows: IntArray
    distances_of_rows: FloatArray
    scans: int

    def nearest(self, k: int, among: BoolArray | None = None) -> Neighbours:
        """Return the `k` nearest scans, nearest first."""
        rows, distances = self.rows, self.distances_of_rows
        if among is not None:
            kept = among[rows]
            rows, distances = rows[kept], distances[kept]
        order = nearest(distances, k)
        return Neighbours.of_distances(rows[order], distances[order])

    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return the distance of each scan, `(K,)`, infinite outside `among` or these segments."""
        distances = np.full(self.scans, np.inf)
        distances[self.rows] = self.distances_of_rows
        return distances if among is None else np.where(among, distances, np.inf)


def nearest_of_sets(distances: FloatArray, sets: Sequence[BoolArray]) -> list[float]:
    """Return the least of `(K,)` distances in each of some sets, infinite without one."""
    return [float(distances[among].min(initial=np.inf)) for among in sets]


def nearest(distances: FloatArray | Float32Array, k: int) -> IntArray:
    """Return the indices of the `k` smallest, nearest first, earlier ones first among equals."""
    if k >= len(distances) or len(distances) <= _FEW:
        return np.argsort(distances, kind="stable")[:k]
    groups = 4 * math.isqrt(len(distances))
    if groups > k:  # k groups have one each that is at most the k-th least of the groups' least
        whole = len(distances) // groups * groups
        least = distances[:whole].reshape(-1, groups).min(axis=0)
    else:
        least = distances.copy()
    least.partition(k - 1)
    candidates = (distances <= least[k - 1]).nonzero()[0]
    order = distances[candidates].argsort(kind="stable")[:k]
    return np.asarray(candidates[order])
