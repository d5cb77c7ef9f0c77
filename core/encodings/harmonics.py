"""Circular harmonics in azimuth, the columns of a harmonic signature."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import ComplexArray, Float32Array, FloatArray


def azimuth_factor(columns: int, r2: int) -> ComplexArray:
    """Return the first `r2` circular harmonics, f_m(j) = exp(-2 pi i m j / J) / sqrt(J), `(J, r2)`.

    Examples:
        >>> factor = azimuth_factor(8, 3)
        >>> bool(np.allclose(factor.conj().T @ factor, np.eye(3)))
        True
    """
    # The product is reduced mod J while it is whole, and f_0 and f_{J/2} are real to the bit.
    turns = np.outer(np.arange(columns), np.arange(r2)) % columns / columns
    factor = np.exp(-2j * np.pi * turns)
    factor.imag[2 * turns % 1 == 0] = 0.0
    return np.asarray(factor / np.sqrt(columns))


def weights(columns: int, r2: int) -> FloatArray:
    """Return w_m, `(r2,)`: a harmonic counts for its conjugate too, but 0 and J/2 have none.

    With them |G|^2 = sum_m w_m sum_r |G_rm|^2 is the energy that the encoding keeps of an image.

    Examples:
        >>> weights(8, 5).tolist()
        [1.0, 2.0, 2.0, 2.0, 1.0]
    """
    harmonic = np.arange(r2)
    return np.where((harmonic == 0) | (2 * harmonic == columns), 1.0, 2.0)


def harmonic_elements(scans: int, renderings: int, rows: int, ranks: tuple[int, int]) -> int:
    """Return I r1 + D + K D r1 (2 r2 - 1): a complex number is two, the first column real.

    Examples:
        >>> harmonic_elements(scans=3800, renderings=5, rows=20, ranks=(5, 5))
        855105
    """
    r1, r2 = ranks
    return rows * r1 + renderings + scans * renderings * r1 * (2 * r2 - 1)


def encode(
    images: Float32Array | FloatArray, u: Float32Array | FloatArray, r2: int
) -> ComplexArray:
    """Return G = U^T S F of `(..., I, J)` images, `(..., r1, r2)`; the first column is real."""
    factor = azimuth_factor(images.shape[-1], r2)
    radial = u.astype(np.float64).T @ images.astype(np.float64)
    return np.asarray(radial @ factor.real + 1j * (radial @ factor.imag))


def energy(signatures: NDArray[np.complexfloating[Any, Any]], columns: int) -> FloatArray:
    """Return |G|^2 in the weighted norm of `(..., r1, r2)` signatures, `(...)`."""
    squared = np.square(signatures.real, dtype=np.float64)
    squared += np.square(signatures.imag, dtype=np.float64)
    return np.asarray(squared.sum(axis=-2) @ weights(columns, signatures.shape[-1]))
