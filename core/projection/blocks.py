"""Blocks of returns: what is computed with one stays in the processor's cache."""

from collections.abc import Iterator

from core.arrays import Float32Array, IntArray

RETURNS_ONCE = 8192
"""64 kB a number: the ten or so of each return stay in the cache."""


def blocks(rows: Float32Array | IntArray, size: int = RETURNS_ONCE) -> Iterator[slice]:
    """Yield slices of rows, in their order.

    Examples:
        >>> import numpy as np
        >>> list(blocks(np.arange(5), 2))
        [slice(0, 2, None), slice(2, 4, None), slice(4, 6, None)]
    """
    return (slice(start, start + size) for start in range(0, len(rows), size))
