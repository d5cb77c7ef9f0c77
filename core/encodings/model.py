"""The bases and signatures of a map, and the search through them."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray, arrays_of, frozen
from core.encodings.basis import Basis
from core.encodings.signature import Signature
from core.errors import InvalidMap, UnknownSegment
from core.projection.imager import Image
from core.projection.probe import Displacement
from core.projection.visibility import FULL_VIEW, View

if TYPE_CHECKING:
    from core.parameters import MapParameters

_LARGEST_SIGNATURE = 1e12  # sums of squares stay finite in single precision too
_FEW = 256  # distances that are sorted as fast as the nearest are found
_LARGEST_OF_BASIS = 1.001  # its columns have length 1


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
    """What a query is limited to beside those that calibrate its map: it tells places apart less.

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
        limits: Of a query that has or sees less than those that calibrate a map, `None` of others.
    """

    segments: tuple[int, ...]
    verified: ClassVar[bool] = False
    evidence: float = 1.0
    limits: QueryLimits | None = None

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
        rows: `(n,)` rows of the segments' scans.
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


class Model(ABC):
    """The bases and signatures of a map in one encoding: scans in order, cut into segments.

    Attributes:
        encoding: The encoding's name.
        signatures: `(K, ...)` of every scan.
        segment_start: `(L + 1,)` row of each segment's first scan, and K.
    """

    encoding: ClassVar[str]
    segment_start: IntArray

    if TYPE_CHECKING:  # a field of some models, computed by others

        @property
        def signatures(self) -> NDArray[Any]:
            """All of them."""

    def __len__(self) -> int:
        return int(self.segment_start[-1])

    @property
    def segments(self) -> int:
        """L, how many segments there are."""
        return len(self.segment_start) - 1

    @cached_property
    def segment_of_scan(self) -> IntArray:
        """The segment of each scan, `(K,)`."""
        segments = np.arange(self.segments)
        return frozen(np.repeat(segments, np.diff(self.segment_start)), np.int64)

    @property
    @abstractmethod
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""

    @property
    @abstractmethod
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""

    @property
    def recorded(self) -> NDArray[Any]:
        """Signatures of the scans as they were recorded, `(K, r1, r2)`."""
        return self.signatures

    @property
    def recorded_lateral_m(self) -> float:
        """How far to the left of the recorded line the viewpoint of `recorded` is."""
        return 0.0

    @property
    def gives_relative_yaw(self) -> bool:
        """Whether a match has a relative yaw."""
        return False

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file."""
        return arrays_of(self)

    @abstractmethod
    def search(self, signatures: Sequence[Signature]) -> Search:
        """Compare one scan's signatures with the map's.

        Raises:
            InvalidSignature: If they are of another encoding or do not belong together.
            UnknownSegment: If one is of a segment that the map does not have.
        """

    @abstractmethod
    def search_values(self, values: NDArray[Any], view: View = FULL_VIEW) -> Search:
        """Compare an image that the basis of all segments projected, without checks.

        Args:
            values: The values as `Basis.project` returns them.
            view: What the image shows; full but in an encoding that masks.
        """

    def search_image(self, image: Image, basis: Basis) -> Search:
        """Compare an image, by all that the map has for that: at least by its signatures.

        Args:
            image: An image of the map's kind and grid.
            basis: The basis of all segments.

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
        """
        return self.search_values(basis.project(image), basis.view(image))

    @abstractmethod
    def own_queries(
        self, rows: Iterable[int], named: str, segments: IntArray | None = None
    ) -> Iterator[tuple[Signature, ...]]:
        """Yield for each row the signatures of a query at that scan, as far as the map gives them.

        Args:
            rows: Rows of the map.
            named: Digest of the basis or revision that the signatures name.
            segments: The segments in whose bases the queries are; all without it.
        """

    def search_own(
        self, row: int, limits: QueryLimits | None = None, turned: int = 0
    ) -> Search | None:
        """Return the search of a query at one of its scans, by the small image that it keeps of it.

        `None` of a map without such images, or if nothing is left of one within some limits, whose
        hidden sectors are `turned`.
        """
        return None

    @abstractmethod
    def basis_digests(self, parameters: "MapParameters") -> tuple[str, ...]:
        """Return the digests of the bases that this map has, 64 hexadecimal digits each."""

    @abstractmethod
    def basis(
        self, revision: str, digest: str, parameters: "MapParameters", segments: IntArray
    ) -> Basis:
        """Return the basis of some segments; in an encoding of one basis, that of all segments."""

    def limits_of(self, shape: tuple[int, ...], view: View) -> QueryLimits | None:
        """Return `Search.limits` of a signature of that shape; `None` in most encodings."""
        del shape, view
        return None

    def limited_query(
        self, row: int, named: str, limits: QueryLimits, turned: int
    ) -> Signature | None:
        """Return what `own_queries` yields of a scan, within some limits of `limits_of`.

        Encodings whose `limits_of` is always `None` do not have it.

        Args:
            row: The scan's.
            named: What the signature names.
            limits: Its numbers and view.
            turned: By how many sectors the hidden ones are turned.

        Returns:
            The signature, `None` if nothing of the scan is left.
        """
        raise NotImplementedError

    @abstractmethod
    def select(self, rows: IntArray, segments: IntArray, segment_start: IntArray) -> Self:
        """Return the model of some scans, all those of some segments, unchanged."""

    @abstractmethod
    def joined(self, others: Sequence[Self], segment_start: IntArray) -> Self:
        """Return one model of this one's scans and those of others after it."""

    def require_segments(self, segments: IntArray) -> None:
        """Raise `UnknownSegment` unless the map has every one of `segments`."""
        unknown = segments[(segments < 0) | (segments >= self.segments)]
        if len(unknown):
            raise UnknownSegment(
                f"there is no segment {unknown[0]}; the map has 0..{self.segments - 1}"
            )

    def _require_rising(self, scans: int) -> None:
        starts = self.segment_start
        if starts.ndim != 1 or len(starts) < 2 or starts[0] != 0 or (np.diff(starts) < 1).any():
            raise InvalidMap("segment_start does not rise from 0 through every segment")
        if starts[-1] != scans:
            raise InvalidMap(f"segment_start ends at {starts[-1]}, there are {scans} signatures")


def require_sane(bases: Mapping[str, NDArray[Any]], signatures: NDArray[Any]) -> None:
    """Reject numbers that no build computes, and with which no distance is finite.

    Raises:
        InvalidMap: If one is not finite or too large.
    """
    for name, array, most in (
        *((name, basis, _LARGEST_OF_BASIS) for name, basis in bases.items()),
        ("signatures", signatures, _LARGEST_SIGNATURE),
    ):
        # Parts, not magnitudes: those of complex numbers take ten times as long.
        parts = array.view(array.real.dtype)
        if not np.isfinite(parts).all():
            raise InvalidMap(f"{name} holds numbers that are not finite")
        if parts.size and max(-parts.min(), parts.max()) > most:
            raise InvalidMap(f"{name} holds numbers beyond {most:g}")


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
