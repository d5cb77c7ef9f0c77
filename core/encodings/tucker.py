"""The Tucker2 model of a segment: X = G x1 U x2 V, W = I (paper, sec. 2.2, eq. 1).

With the third factor fixed to the identity, the HO-SVD of `X (I, J, k)` needs two small
eigenproblems only: U from `sum S S^T`, V from `sum S^T S`. Both sums are additive over scans,
so a build streams through its images and merges parts exactly.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray
from core.encodings.blocks import BLOCK_SCANS
from core.errors import InvalidParameters


@dataclass(frozen=True, eq=False)
class Grams:
    """Gram matrices of a set of images, which add over disjoint sets.

    Attributes:
        elevation: `(I, I)`, the sum of S S^T.
        azimuth: `(J, J)`, the sum of S^T S.
        scans: How many images were summed.

    Examples:
        >>> images = np.random.default_rng(0).random((4, 3, 5), dtype=np.float32)
        >>> whole = Grams.of(images)
        >>> parts = Grams.of(images[:1]) + Grams.of(images[1:])
        >>> parts.scans, bool(np.allclose(parts.azimuth, whole.azimuth, rtol=1e-12))
        (4, True)
    """

    elevation: FloatArray
    azimuth: FloatArray
    scans: int

    @classmethod
    def zero(cls, shape: tuple[int, int]) -> "Grams":
        """Return the Grams of no image on a grid of `shape` (I, J)."""
        rows, columns = shape
        return cls(np.zeros((rows, rows)), np.zeros((columns, columns)), 0)

    @classmethod
    def of(cls, images: Float32Array | FloatArray) -> "Grams":
        """Return the Grams of `(n, I, J)` images, summed in float64."""
        total = cls.zero((images.shape[1], images.shape[2]))
        elevation, azimuth = total.elevation, total.azimuth
        for block in _blocks(images):
            by_row = block.reshape(block.shape[0], -1)
            by_column = block.reshape(-1, block.shape[2])
            elevation += by_row @ by_row.T
            azimuth += by_column.T @ by_column
        return cls(elevation, azimuth, len(images))

    def __add__(self, other: "Grams") -> "Grams":
        return Grams(
            self.elevation + other.elevation, self.azimuth + other.azimuth, self.scans + other.scans
        )

    @property
    def squared_norm(self) -> float:
        """|X|^2, the sum of all squared cells."""
        return float(np.trace(self.elevation))


def row_gram(images: Float32Array | FloatArray) -> FloatArray:
    """Return the sum of S S^T of `(n, I, J)` images, `(I, I)`, summed in float64.

    It is additive over images, its trace is |X|^2, and it does not depend on yaw.
    """
    total = np.zeros((images.shape[1], images.shape[1]))
    for block in _blocks(images):
        by_row = block.reshape(block.shape[0], -1)
        total += by_row @ by_row.T
    return total


def leading_basis(gram: FloatArray, rank: int) -> FloatArray:
    """Return the `rank` leading eigenvectors of a symmetric Gram matrix, `(n, rank)`.

    The columns are orthonormal, in order of falling eigenvalue, and signed so that the entry
    largest in magnitude is positive: the same input gives the same basis.

    Raises:
        InvalidParameters: If `rank` is not within 1..n.
    """
    from scipy.linalg import eigh  # only builds need it: decision 33

    n = len(gram)
    if not 1 <= rank <= n:
        raise InvalidParameters(f"the rank is {rank}, wanted 1..{n}")
    _, vectors = eigh(gram, subset_by_index=(n - rank, n - 1), check_finite=False)
    basis = np.asarray(vectors[:, ::-1], dtype=np.float64)
    largest = basis[np.abs(basis).argmax(axis=0), np.arange(rank)]
    return np.ascontiguousarray(basis * np.where(largest < 0, -1.0, 1.0))


def project(images: Float32Array | FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the signatures `U^T S V` of `(n, I, J)` images, `(n, r1, r2)` (paper, sec. 2.3)."""
    signatures = np.empty((len(images), u.shape[1], v.shape[1]))
    for start in range(0, len(images), BLOCK_SCANS):  # one block, and not all, in float64
        block = slice(start, start + BLOCK_SCANS)
        signatures[block] = u.T @ images[block].astype(np.float64, copy=False) @ v
    return signatures


def relative_error(squared_norm: float, signatures: Float32Array | FloatArray) -> float:
    """Return |X - X^| / |X| from |X|^2 and the core tensor; the bases are orthonormal.

    By rounding |G| may exceed |X|, which counts as no error.
    """
    if squared_norm <= 0.0:
        return 0.0
    kept = float(np.square(signatures, dtype=np.float64).sum())
    return float(np.sqrt(max(0.0, 1.0 - kept / squared_norm)))


def storage_elements(
    segments: int, scans: int, grid_shape: tuple[int, int], ranks: tuple[int, int]
) -> int:
    """Return L(I r1 + J r2) + K r1 r2, the size of a TensorMap in numbers (paper, sec. 2.4).

    Examples:
        >>> storage_elements(5, 3800, (30, 361), (5, 5))
        104775
    """
    rows, columns = grid_shape
    r1, r2 = ranks
    return segments * (rows * r1 + columns * r2) + scans * r1 * r2


def _blocks(images: Float32Array | FloatArray) -> Iterator[FloatArray]:
    """Yield `(I, n, J)` float64 blocks: one layout serves the Grams of both modes."""
    for start in range(0, len(images), BLOCK_SCANS):
        block = images[start : start + BLOCK_SCANS]
        yield np.ascontiguousarray(block.transpose(1, 0, 2), dtype=np.float64)
