"""The most that a query can be like scans of a large map in any heading, read from their codes.

sum_m |sum_r q_rm conj(G_rm)|, all waves in phase, of the best rendering of each scan: that needs
every code once and a few hundred operations for it, which are all that a search of a large map
costs. NumPy has no product of bytes and makes floats of them first; with the extra `large-maps`
numba compiles one loop that does not (docs/decisions/0037-large-maps.md).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, IntArray
from core.encodings.harmonics import correlating

_BLOCK_SCANS = 3072  # one harmonic of all their renderings stays in a processor's cache
_COMPILED_BLOCK_SCANS = 8192  # of one rendering
_LEAST_COMPILED = 20_001  # renderings, more than a small map has: the import of numba takes long
_KEPT = 16  # loops


def best_in_phase(
    codes: NDArray[np.int8], query: Complex64Array, factor: Float32Array
) -> Float32Array:
    """Return the largest sum of magnitudes of each scan over its renderings, `(K,)`.

    Args:
        codes: `(2 r2 - 1, r1, D, K)`; `whole_codes` are read the fastest.
        query: `(n, m)` of the first n radial components, m up to r2.
        factor: `(D, K)` by which the sum of each rendering is multiplied, not negative.
    """
    return _best(codes, query, factor, [[0, factor.shape[1]]], is_noted=False)[0]


def best_rendering_in_phase(
    codes: NDArray[np.int8],
    query: Complex64Array,
    factor: Float32Array,
    spans: IntArray | None = None,
) -> tuple[Float32Array, NDArray[np.int8]]:
    """Return `best_in_phase`, and of which rendering it is, which takes half as long again.

    Args:
        codes: The codes, as in `best_in_phase`.
        query: The query, as in `best_in_phase`.
        factor: The factor, as in `best_in_phase`.
        spans: `(n, 2)` first scan and end of ranges, by default one of all. No other scan is read;
            the result has those of one range after another.

    Returns:
        `(K,)` each.
    """
    ranges = [[0, factor.shape[1]]] if spans is None else spans.tolist()
    return _best(codes, query, factor, ranges, is_noted=True)


def _best(
    codes: NDArray[np.int8],
    query: Complex64Array,
    factor: Float32Array,
    ranges: Sequence[Sequence[int]],
    *,
    is_noted: bool,
) -> tuple[Float32Array, NDArray[np.int8]]:
    count = sum(end - start for start, end in ranges)
    whole = whole_codes(codes) if count * len(factor) >= _LEAST_COMPILED else None
    kernel = None if whole is None else _compiled(len(query), is_noted=is_noted)
    if whole is None or kernel is None:
        return _by_numpy(codes, query, factor, ranges)
    best, which = np.zeros(count, np.float32), np.zeros(count if is_noted else 0, np.int8)
    real, imag = np.ascontiguousarray(query.real.T), np.ascontiguousarray(query.imag.T)
    total = np.empty(_COMPILED_BLOCK_SCANS, np.float32)
    blocks = [
        (at, min(at + _COMPILED_BLOCK_SCANS, end))
        for start, end in ranges
        for at in range(start, end, _COMPILED_BLOCK_SCANS)
    ]
    by = _read_only(np.ascontiguousarray(factor))
    kernel(whole, real, imag, by, np.array(blocks, np.int64), best, which, total)
    return best, which


def in_phase(waves: Float32Array) -> Float32Array:
    """Return the sums of magnitudes of `(m, 2, n)` waves, `(n,)`: no heading has more."""
    squares = np.square(waves)
    magnitudes = np.add(squares[:, 0], squares[:, 1], out=squares[:, 0])
    return np.asarray(np.sqrt(magnitudes, out=magnitudes).sum(axis=0))


def whole_codes(codes: NDArray[np.int8]) -> NDArray[np.int8] | None:
    """Return the contiguous array of which these may be the first radial components.

    Of a view numba would not know that its scans are contiguous. `None` of another order.
    """
    if codes.flags.c_contiguous:
        return _read_only(codes)
    rows, _, renderings, scans = codes.shape
    components = codes.strides[0] // (renderings * scans)
    shape = (rows, components, renderings, scans)
    if codes.strides != (components * renderings * scans, renderings * scans, scans, 1):
        return None
    return np.lib.stride_tricks.as_strided(codes, shape, codes.strides, writeable=False)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view of it: numba compiles once for arrays that are so, once for others."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


def _by_numpy(
    codes: NDArray[np.int8],
    query: Complex64Array,
    factor: Float32Array,
    ranges: Sequence[Sequence[int]],
) -> tuple[Float32Array, NDArray[np.int8]]:
    factors, done = correlating(query), 0
    count = sum(end - start for start, end in ranges)
    best, which = np.empty(count, np.float32), np.empty(count, np.int8)
    for rows in _blocks(ranges, _BLOCK_SCANS):
        found = _block_by_numpy(codes, factors, factor, rows)
        block = slice(done, done + found.shape[1])
        found.max(axis=0, out=best[block])
        which[block] = found.argmax(axis=0)
        done = block.stop
    return best, which


def _block_by_numpy(
    codes: NDArray[np.int8], factors: Float32Array, factor: Float32Array, rows: slice | IntArray
) -> Float32Array:
    by = factor[:, rows]
    components = factors.shape[2] // 2
    numbers = np.empty((2 * components, by.size), np.float32)
    waves, found = np.empty((2, by.size), np.float32), np.zeros(by.size, np.float32)
    for harmonic, of_query in enumerate(factors):
        read = codes[max(0, 2 * harmonic - 1) : 2 * harmonic + 1, :components][..., rows]
        used = numbers[: len(read) * components]
        used.reshape(read.shape)[...] = read
        np.matmul(of_query[:, : len(used)], used, out=waves)
        np.square(waves, out=waves)
        magnitude = np.add(waves[0], waves[1], out=waves[0])
        found += np.sqrt(magnitude, out=magnitude)
    of_renderings = found.reshape(by.shape)
    of_renderings *= by
    return of_renderings


def _blocks(ranges: Sequence[Sequence[int]], most: int) -> list[slice | IntArray]:
    """Return the scans of some ranges in their order, at most so many at once.

    Examples:
        >>> _blocks([[0, 5], [9, 10], [12, 14]], 4)
        [slice(0, 4, None), array([ 4,  9, 12, 13])]
    """
    groups: list[list[tuple[int, int]]] = [[]]
    room = most
    for start, end in ranges:
        at = start
        while at < end:
            until = min(at + room, end)
            groups[-1].append((at, until))
            room -= until - at
            at = until
            if not room:
                groups.append([])
                room = most
    return [
        slice(*group[0])
        if len(group) == 1
        else np.concatenate([np.arange(start, end) for start, end in group])
        for group in groups
        if group
    ]


@lru_cache(maxsize=_KEPT)
def _compiled(radial: int, *, is_noted: bool) -> Callable[..., None] | None:
    """Return the loop for so many radial components, `None` without numba.

    Their number is a constant of it: only then the loop over scans is one of vectors.

    Args:
        radial: The number of radial components.
        is_noted: Whether the loop says which rendering is the best one.
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
        blocks: IntArray,
        found: Float32Array,
        which: NDArray[np.int8],
        total: Float32Array,
    ) -> None:
        done = 0
        for number in range(len(blocks)):
            start, end = blocks[number, 0], blocks[number, 1]
            of_block, which_of_block = found[done : done + end - start], which[done:]
            done += end - start
            for rendering in range(len(factor)):
                part = codes[:, :, rendering, start:end]
                by = factor[rendering, start:end]
                for at in range(len(of_block)):
                    x = np.float32(0.0)
                    for r in range(radial):
                        x += real[0, r] * np.float32(part[0, r, at])
                    total[at] = abs(x)
                for m in range(1, len(real)):
                    one, other = part[2 * m - 1], part[2 * m]
                    for at in range(len(of_block)):
                        x, y = np.float32(0.0), np.float32(0.0)
                        for r in range(radial):
                            u, v = np.float32(one[r, at]), np.float32(other[r, at])
                            x += real[m, r] * u + imag[m, r] * v
                            y += imag[m, r] * u - real[m, r] * v
                        total[at] += np.sqrt(x * x + y * y)
                for at in range(len(of_block)):
                    of_it = total[at] * by[at]
                    if is_noted:
                        if of_it > of_block[at]:
                            of_block[at], which_of_block[at] = of_it, rendering
                    else:
                        of_block[at] = max(of_block[at], of_it)

    return _kept(best, numba)


def _kept(loop: Callable[..., None], numba: ModuleType) -> Callable[..., None]:
    """Return the loop as machine code, which numba keeps in a file for later processes."""
    types = numba.types
    codes = types.Array(types.int8, 4, "C", readonly=True)
    factor = types.Array(types.float32, 2, "C", readonly=True)
    part, numbers = types.float32[:, ::1], types.float32[::1]
    signature = types.void(
        codes, part, part, factor, types.int64[:, ::1], numbers, types.int8[::1], numbers
    )
    compiled = partial(numba.njit, signature, fastmath=True, nogil=True)
    try:
        return compiled(cache=True)(loop)  # type: ignore[no-any-return]
    except Exception:  # noqa: BLE001 - no folder that can be written, or a damaged file
        return compiled()(loop)  # type: ignore[no-any-return]
