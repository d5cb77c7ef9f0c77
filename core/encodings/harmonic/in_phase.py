"""The most that a query can be like scans of a large map in any heading, read from their codes.

sum_m |sum_r q_rm conj(G_rm)|, all waves in phase, of the best rendering of each scan: that needs
every code once and a few hundred operations for it, which are all that a search of a large map
costs. NumPy has no product of bytes and makes floats of them first; with the extra `large-maps`
numba compiles one loop that does not (docs/decisions/0037-large-maps.md).
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array
from core.encodings.harmonics import correlating

_BLOCK_SCANS = 3072  # one harmonic of all their renderings stays in a processor's cache
_COMPILED_BLOCK_SCANS = 8192  # of one rendering
_LEAST_COMPILED = 20_000  # renderings: of fewer, NumPy takes 0.3 ms
_KEPT = 8  # numbers of radial components


def best_in_phase(
    codes: NDArray[np.int8], query: Complex64Array, factor: Float32Array
) -> Float32Array:
    """Return the largest sum of magnitudes of each scan over its renderings, `(K,)`.

    Args:
        codes: `(2 r2 - 1, r1, D, K)`.
        query: `(r1, m)`, m up to r2.
        factor: `(D, K)` by which the sum of each rendering is multiplied, not negative.
    """
    whole = _whole(codes) if factor.size >= _LEAST_COMPILED else None
    kernel = None if whole is None else _compiled(len(query))
    if whole is None or kernel is None:
        return _by_numpy(codes, query, factor)
    best = np.zeros(factor.shape[1], np.float32)
    real, imag = (np.ascontiguousarray(part.T) for part in (query.real, query.imag))
    factor = factor.view()
    factor.flags.writeable = False  # numba compiles once for arrays that are, once for others
    kernel(whole, real, imag, factor, best, np.empty(_COMPILED_BLOCK_SCANS, np.float32))
    return best


def in_phase(waves: Float32Array) -> Float32Array:
    """Return the sums of magnitudes of `(m, 2, n)` waves, `(n,)`: no heading has more."""
    found = np.zeros(waves.shape[-1], np.float32)
    for real, imag in waves:
        magnitude = np.square(real)
        magnitude += np.square(imag)
        found += np.sqrt(magnitude, out=magnitude)
    return found


def _whole(codes: NDArray[np.int8]) -> NDArray[np.int8] | None:
    """Return the contiguous array of which these may be the first radial components.

    Of a view numba would not know that its scans are contiguous. `None` of another order.
    """
    rows, _, renderings, scans = codes.shape
    components = codes.strides[0] // (renderings * scans)
    shape = (rows, components, renderings, scans)
    if codes.strides != (components * renderings * scans, renderings * scans, scans, 1):
        return None
    return np.lib.stride_tricks.as_strided(codes, shape, codes.strides, writeable=False)


def _by_numpy(codes: NDArray[np.int8], query: Complex64Array, factor: Float32Array) -> Float32Array:
    best = np.empty(factor.shape[1], np.float32)
    factors = correlating(query)
    for start in range(0, len(best), _BLOCK_SCANS):
        block = slice(start, min(start + _BLOCK_SCANS, len(best)))
        renderings = factor[:, block].size
        numbers = np.empty((2 * len(query), renderings), np.float32)
        waves, found = np.empty((2, renderings), np.float32), np.zeros(renderings, np.float32)
        for harmonic, of_query in enumerate(factors):
            read = codes[max(0, 2 * harmonic - 1) : 2 * harmonic + 1, ..., block]
            used = numbers[: len(read) * len(query)]
            used.reshape(read.shape)[...] = read
            np.matmul(of_query[:, : len(used)], used, out=waves)
            np.square(waves, out=waves)
            magnitude = np.add(waves[0], waves[1], out=waves[0])
            found += np.sqrt(magnitude, out=magnitude)
        of_renderings = found.reshape(len(factor), -1)
        of_renderings *= factor[:, block]
        of_renderings.max(axis=0, out=best[block])
    return best


@lru_cache(maxsize=_KEPT)
def _compiled(radial: int) -> Callable[..., None] | None:
    """Return the loop for so many radial components, `None` without numba.

    Their number is a constant of it: only then the loop over scans is one of vectors.
    """
    try:
        import numba  # 116 MB of memory and half a second, which only large maps are worth
    except ImportError:
        return None

    def best(
        codes: NDArray[np.int8],
        real: Float32Array,
        imag: Float32Array,
        factor: Float32Array,
        found: Float32Array,
        total: Float32Array,
    ) -> None:
        renderings, scans = factor.shape
        for start in range(0, scans, _COMPILED_BLOCK_SCANS):
            end = min(start + _COMPILED_BLOCK_SCANS, scans)
            for rendering in range(renderings):
                part = codes[:, :, rendering, start:end]
                for at in range(end - start):
                    x = np.float32(0.0)
                    for r in range(radial):
                        x += real[0, r] * np.float32(part[0, r, at])
                    total[at] = abs(x)
                for m in range(1, len(real)):
                    one, other = part[2 * m - 1], part[2 * m]
                    for at in range(end - start):
                        x, y = np.float32(0.0), np.float32(0.0)
                        for r in range(radial):
                            u, v = np.float32(one[r, at]), np.float32(other[r, at])
                            x += real[m, r] * u + imag[m, r] * v
                            y += imag[m, r] * u - real[m, r] * v
                        total[at] += np.sqrt(x * x + y * y)
                for at in range(end - start):
                    of_it = total[at] * factor[rendering, start + at]
                    found[start + at] = max(found[start + at], of_it)

    compiled: Any = numba.njit(fastmath=True, nogil=True)(best)
    return compiled  # type: ignore[no-any-return]
