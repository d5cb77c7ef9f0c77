"""Circular harmonics in azimuth, the columns of a harmonic signature."""

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, ComplexArray, Float32Array, FloatArray, frozen
from core.projection.imager import Views
from core.projection.visibility import View

if TYPE_CHECKING:
    from core.parameters import MapParameters

# Of a norm between them, products with numbers of maps are far from the limits of single precision.
_TINY, _HUGE = 1e-30, 1e20


@lru_cache(maxsize=16)
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
    return frozen(factor / np.sqrt(columns), np.complex128)


@lru_cache(maxsize=16)
def weights(columns: int, r2: int) -> FloatArray:
    """Return w_m, `(r2,)`: a harmonic counts for its conjugate too, but 0 and J/2 have none.

    With them |G|^2 = sum_m w_m sum_r |G_rm|^2 is the energy that the encoding keeps of an image.

    Examples:
        >>> weights(8, 5).tolist()
        [1.0, 2.0, 2.0, 2.0, 1.0]
    """
    harmonic = np.arange(r2)
    alone = (harmonic == 0) | (2 * harmonic == columns)
    return frozen(np.where(alone, 1.0, 2.0), np.float64)


@lru_cache(maxsize=16)
def root_weights(columns: int, r2: int) -> FloatArray:
    """Return sqrt(w_m), `(r2,)`: numbers times these have the weighted norm."""
    return frozen(np.sqrt(weights(columns, r2)), np.float64)


ANY_VIEW_RANKS = (10, 12)
"""Ranks that a map of any views keeps: a partial view mixes them into those that are sent."""

_TRADED = 2  # harmonics for as many radial components
_FEWEST_LEFT = 5  # harmonics: as many as the paper's ranks
_LEAST_RANKS = 3  # by 2 x 2 numbers three in four known places are not found


def kept_ranks(parameters: "MapParameters") -> tuple[int, int]:
    """Return the ranks of each rendering that a map keeps, at least those that are sent."""
    (r1, r2), (rows, columns) = parameters.ranks, parameters.grid.shape
    if parameters.views == Views.FULL:
        return r1, r2
    radial, harmonics = ANY_VIEW_RANKS
    return min(rows, max(radial, r1 + _TRADED)), max(r2, min(harmonics, columns // 2))


def sent_ranks(parameters: "MapParameters", view: View) -> tuple[int, int]:
    """Return the ranks of a query of this view, in about as many numbers as `ranks`.

    What is left of a narrow view differs between places by its rings more than by its azimuths:
    where harmonics outnumber radial components, it has two fewer of these, but five at least, and
    two more of those.

    Examples:
        >>> from core.parameters import MapParameters
        >>> any_views = MapParameters.for_sensor(ranks=(6, 7), views=Views.ANY)
        >>> sent_ranks(any_views, View()), sent_ranks(any_views, View(tuple(range(20))))
        ((6, 7), (8, 5))
    """
    if parameters.views == Views.FULL or not view.is_narrow:
        return parameters.ranks
    return narrow_ranks(parameters.ranks, kept_ranks(parameters)[0])


def narrow_ranks(ranks: tuple[int, int], most_radial: int) -> tuple[int, int]:
    """Return the ranks of a narrow view, from those of others and the most radial components."""
    r1, r2 = ranks
    if r2 <= max(r1, _FEWEST_LEFT + 1):
        return r1, r2
    return min(r1 + _TRADED, most_radial), r2 - _TRADED


def least_ranks(usual: tuple[int, int]) -> tuple[int, int]:
    """Return the least ranks of a query that is compared, from the usual ones."""
    return min(_LEAST_RANKS, usual[0]), min(_LEAST_RANKS, usual[1])


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


def two_sided(signatures: NDArray[np.complexfloating[Any, Any]]) -> NDArray[Any]:
    """Return `(..., r2)` harmonics with those of negative numbers before them, `(..., 2 r2 - 1)`.

    Examples:
        >>> two_sided(np.array([1.0, 2.0 + 3.0j])).tolist()
        [(2-3j), (1+0j), (2+3j)]
    """
    return np.concatenate([signatures[..., :0:-1].conj(), signatures], axis=-1)


def as_real(waves: NDArray[np.complexfloating[Any, Any]]) -> Float32Array:
    """Return the real parts of `(m, n)` waves and the imaginary ones but the first: `(2 m - 1, n)`.

    Examples:
        >>> as_real(np.array([[1.0 + 0.0j], [2.0 + 3.0j]])).T.tolist()
        [[1.0, 2.0, 3.0]]
    """
    return np.concatenate([waves.real, waves.imag[1:]]).astype(np.float32)


def correlating(queries: Complex64Array) -> Float32Array:
    """Return what multiplies the parts of G to those of sum_r q_rm conj(G_rm), `(m, 2, 2 r1)`.

    The parts of G_m are its r1 real ones, then its imaginary ones; a product has one of each.

    Args:
        queries: q, `(r1, m)`.

    Examples:
        >>> q, g = np.array([[1 + 2j]], np.complex64), np.array([[3 + 4j]])
        >>> (correlating(q)[0] @ [3.0, 4.0]).tolist(), (q * g.conj()).tolist()
        ([11.0, 2.0], [[(11+2j)]])
    """
    real, imag = queries.real.T, queries.imag.T
    harmonics, components = real.shape
    matrix = np.empty((harmonics, 2, 2 * components), np.float32)  # `np.block` takes 0.1 ms
    matrix[:, 0, :components], matrix[:, 0, components:] = real, imag
    matrix[:, 1, :components], matrix[:, 1, components:] = imag, -real
    return matrix


def circular_energy(
    signatures: NDArray[np.complexfloating[Any, Any]], count: int | None = None
) -> ComplexArray:
    """Return where on the circle the energy of `(..., r1, r2)` signatures is, `(..., count)`.

    As harmonics E_d = sum_k sum_r G_r(k+d) conj(G_rk), from d = 0 on: E_0 is |G|^2. There are
    2 r2 - 1 of them, which is the default.

    Examples:
        >>> circular_energy(np.array([[3.0 + 0.0j]])).tolist()
        [(9+0j)]
    """
    harmonics = 2 * signatures.shape[-1] - 1
    count = harmonics if count is None else min(count, harmonics)
    # With fewer samples the highest harmonics would count for the first ones too.
    samples = 1 << (harmonics + count - 1).bit_length()
    if signatures.ndim == 2:  # of one, products with matrices take a third of the time
        to_headings, to_waves = _transforms(signatures.shape[-1], count, samples)
        parts = np.ascontiguousarray(signatures, np.complex128).view(np.float64)
        return np.asarray(np.square(parts @ to_headings).sum(axis=0) @ to_waves)
    waves = np.fft.irfft(signatures, samples, axis=-1)
    squared = np.square(waves).sum(axis=-2)
    return np.asarray(np.fft.rfft(squared, axis=-1)[..., :count] * samples)


@lru_cache(maxsize=16)
def _transforms(r2: int, count: int, samples: int) -> tuple[FloatArray, ComplexArray]:
    """Return what makes values in headings of harmonics' parts, and waves of such values.

    Returns:
        `(2 r2, samples)`, for real and imaginary parts in turn, and `(samples, count)`.
    """
    angles = 2.0 * np.pi / samples * np.outer(np.arange(max(r2, count)), np.arange(samples))
    turns = np.exp(1j * angles)
    counted = turns[:r2] * np.where(np.arange(r2) > 0, 2.0, 1.0)[:, None]
    parts = np.stack([counted.real, -counted.imag], axis=1).reshape(2 * r2, samples)
    return frozen(parts, np.float64), frozen(turns[:count].conj().T / samples, np.complex128)


def energy(signatures: NDArray[np.complexfloating[Any, Any]], columns: int) -> FloatArray:
    """Return |G|^2 in the weighted norm of `(..., r1, r2)` signatures, `(...)`."""
    squared = np.square(signatures.real, dtype=np.float64)
    squared += np.square(signatures.imag, dtype=np.float64)
    return np.asarray(squared.sum(axis=-2) @ weights(columns, signatures.shape[-1]))


def of_usual_norm(signature: ComplexArray, columns: int) -> ComplexArray:
    """Return a signature, scaled to norm 1 if products with it would underflow or overflow.

    For distances that are relative: they are those of the signature.
    """
    norm = math.sqrt(energy(signature, columns))
    is_usual = norm == 0.0 or _TINY <= norm <= _HUGE
    return signature if is_usual else np.asarray(signature / norm)
