"""Short codes of places, by which the few that a query may be of are found among millions.

The products of two rows of one harmonic, G_rm conj(G_sm), do not depend on the heading. They are
projected to the directions in which places differ most, compared with how one place differs from
its neighbours and from beside the line (Fisher's linear discriminant), and rounded to a byte.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray, arrays_of, freeze
from core.encodings.harmonics import weights
from core.errors import InvalidMap

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel

Int8Array = NDArray[np.int8]

CODED_RANKS = (6, 7)
"""Of a signature's numbers that its code is made of: those that vehicles send by default."""
RENDERINGS = 5
"""Of a place that are coded; of one with fewer, some twice."""

_LENGTH = 64  # of a code: docs/decisions/0035-where-among-all-maps.md
_MOST_TRAINED = 4000  # places, of which the projection is made
_RIDGE = 1e-5  # of the mean variance within a place
_CLIPPED = 0.001  # share of numbers beyond a byte
_MOST_LISTS = 2048
_PLACES_A_LIST = 100  # at least: with fewer places there are fewer lists
_ROUNDS = 8  # of k-means
_SAMPLES_A_LIST = 40
_SEED = 35_001


@dataclass(frozen=True, eq=False)
class PlaceCode:
    """From signatures to codes, and lists of codes that are alike.

    Attributes:
        projection: `(f, v)` float32, from the features of a signature to steps of a byte.
        mean: `(v,)` float32, which is subtracted: a byte has no room for it.
        centres: `(c, v)` float32, of the lists.
        ranks: `(2,)`, how many radial components and harmonics are coded.
    """

    projection: Float32Array
    mean: Float32Array
    centres: Float32Array
    ranks: IntArray

    def __post_init__(self) -> None:
        freeze(self, projection=np.float32, mean=np.float32)
        freeze(self, centres=np.float32, ranks=np.int64)
        radial, harmonics = self.ranks.tolist()
        if self.projection.shape != (radial * radial * harmonics, self.centres.shape[1]):
            raise InvalidMap(
                f"a projection of {self.projection.shape} does not fit ranks {self.ranks.tolist()}"
                f" and centres of {self.centres.shape}"
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return arrays_of(self)

    @property
    def radial(self) -> int:
        """How many radial components are coded."""
        return int(self.ranks[0])

    @property
    def harmonics(self) -> int:
        """How many harmonics are coded."""
        return int(self.ranks[1])

    @classmethod
    def train(cls, models: Sequence["HarmonicModel"], places: int) -> "PlaceCode":
        """Return a code for places that are like those of some maps.

        Args:
            models: At least one, of one basis.
            places: How many will be coded, which the number of lists depends on.
        """
        rng = np.random.default_rng(_SEED)
        kept = models[0].ranks
        radial, harmonics = min(CODED_RANKS[0], kept[0]), min(CODED_RANKS[1], kept[1])
        each = max(2, _MOST_TRAINED // len(models))
        of_places, rendered, within = [], [], []
        for model in models[:: max(1, len(models) * 2 // _MOST_TRAINED)]:
            rows = np.sort(rng.permutation(max(1, len(model) - 1))[:each])
            coded = beside(model, model.stored.numbers)
            here = features(coded[rows], radial, harmonics)
            ahead = features(coded[np.minimum(rows + 1, len(model) - 1), 2], radial, harmonics)
            of_places.append(here[:, 2])
            rendered.append(here.reshape(-1, here.shape[-1]))
            within += [here[:, 1] - here[:, 2], here[:, 3] - here[:, 2], ahead - here[:, 2]]
        found = np.concatenate(of_places)
        projection = _discriminant(found, np.concatenate(within))
        mean = (found @ projection).mean(axis=0)
        codes = np.concatenate(rendered) @ projection - mean
        step = float(np.quantile(np.abs(codes), 1.0 - _CLIPPED)) / 127.0 or 1.0
        lists = int(np.clip(places // _PLACES_A_LIST, 1, _MOST_LISTS))
        lists = min(lists, max(1, len(codes) // 8))  # of few maps there are few samples
        samples = codes[rng.permutation(len(codes))[: lists * _SAMPLES_A_LIST]] / step
        centres = _k_means(samples.astype(np.float32), lists, rng)
        return cls(
            (projection / step).astype(np.float32),
            (mean / step).astype(np.float32),
            centres,
            np.array([radial, harmonics]),
        )

    def of(self, signatures: NDArray[Any]) -> Int8Array:
        """Return the codes of `(..., r1, r2)` signatures, `(..., v)`."""
        found = features(signatures, self.radial, self.harmonics) @ self.projection
        codes = np.clip(np.rint(found - self.mean), -127, 127)
        return np.asarray(codes.astype(np.int8))

    def of_query(self, values: NDArray[Any]) -> Float32Array:
        """Return the code of a query, not rounded, `(v,)`; what it did not send is 0."""
        whole = np.zeros((self.radial, self.harmonics), np.complex64)
        sent = values[: self.radial, : self.harmonics]
        whole[: sent.shape[0], : sent.shape[1]] = sent
        found = features(whole, self.radial, self.harmonics) @ self.projection
        return np.asarray(found - self.mean, dtype=np.float32)

    def lists_of(self, codes: Int8Array) -> IntArray:
        """Return the list of each of `(n, v)` codes, `(n,)`."""
        half = np.square(self.centres).sum(axis=1) / 2.0
        nearest = np.empty(len(codes), np.int64)
        for start in range(0, len(codes), 4096):
            block = codes[start : start + 4096].astype(np.float32)
            nearest[start : start + 4096] = (block @ self.centres.T - half).argmax(axis=1)
        return nearest


def beside(model: "HarmonicModel", of_renderings: NDArray[Any]) -> NDArray[Any]:
    """Return the `(K, 5, ...)` of `(K, D, ...)` renderings that are coded, the third on the line.

    Beside it two on each side, as far as the map has them.
    """
    middle = int(np.abs(model.lateral_offset_m).argmin())
    last = len(model.lateral_offset_m) - 1
    return np.asarray(of_renderings[:, np.clip(middle + np.arange(-2, 3), 0, last)])


def features(signatures: NDArray[Any], radial: int, harmonics: int) -> Float32Array:
    """Return what does not depend on heading, of `(..., r1, r2)` signatures, `(..., f)`.

    The squares of every number and the products of two rows, for each harmonic, of a signature of
    norm 1.
    """
    some: NDArray[Any] = signatures[..., :radial, :harmonics].astype(np.complex64)
    counted = np.sqrt(weights(2 * harmonics, harmonics)).astype(np.float32)
    weighted: NDArray[Any] = some * counted
    norm = np.sqrt((np.square(weighted.real) + np.square(weighted.imag)).sum(axis=(-2, -1)))
    some = weighted / np.where(norm > 0, norm, np.float32(1.0))[..., None, None]
    one, other = np.triu_indices(radial, 1)
    products = some[..., one, :] * some[..., other, :].conj() * np.float32(np.sqrt(2.0))
    squares = np.square(some.real) + np.square(some.imag)
    parts = np.concatenate([squares, products.real, products.imag], axis=-2)
    return np.asarray(parts.reshape(*parts.shape[:-2], -1), dtype=np.float32)


def _discriminant(places: Float32Array, within: Float32Array) -> FloatArray:
    """Return the directions of most variance between places to that within one, `(f, v)`."""
    inner = np.cov(within.T.astype(np.float64))
    inner += _RIDGE * np.trace(inner) / len(inner) * np.eye(len(inner)) + 1e-12 * np.eye(len(inner))
    variance, axes = np.linalg.eigh(inner)
    white = axes / np.sqrt(variance)
    between = white.T @ np.cov(places.T.astype(np.float64)) @ white
    _, directions = np.linalg.eigh(between)
    return np.asarray(white @ directions[:, ::-1][:, :_LENGTH])


def _k_means(samples: Float32Array, count: int, rng: np.random.Generator) -> Float32Array:
    centres = samples[rng.permutation(len(samples))[:count]].copy()
    for _ in range(_ROUNDS if count > 1 else 1):
        half = np.square(centres).sum(axis=1) / 2.0
        nearest = np.concatenate(
            [
                (samples[start : start + 4096] @ centres.T - half).argmax(axis=1)
                for start in range(0, len(samples), 4096)
            ]
        )
        counts = np.bincount(nearest, minlength=len(centres))
        order = np.argsort(nearest, kind="stable")
        used = np.flatnonzero(counts)
        starts = np.concatenate([[0], np.cumsum(counts)])[used]
        centres[used] = np.add.reduceat(samples[order], starts) / counts[used, None]
    return centres
