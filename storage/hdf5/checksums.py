"""The two checksums of HDF5: of its structures, and of its chunks of numbers."""

import struct
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MASK = 0xFFFFFFFF
_HEADER_BYTES = 2**10  # of structures whose checksums are kept
_ROW = 512  # 16-bit words that are summed at once
_PIECE = _ROW * 2**15  # so many words: sums of columns stay below 2**32


def lookup3(content: bytes) -> int:
    """Return Bob Jenkins' lookup3 of a structure's bytes, as HDF5 takes it: seed 0.

    Examples:
        >>> hex(lookup3(b"")), hex(lookup3(b"Four score and seven years ago"))
        ('0xdeadbeef', '0x17770551')
    """
    return _known_sum(content) if len(content) <= _HEADER_BYTES else _sum_of(content)


def _sum_of(content: bytes) -> int:
    a = b = c = (0xDEADBEEF + len(content)) & _MASK
    if not content:
        return c
    padded = content + bytes(-len(content) % 12)
    words = struct.unpack(f"<{len(padded) // 4}I", padded)
    last = len(words) - 3
    for i in range(0, last, 3):
        a, b, c = (a + words[i]) & _MASK, (b + words[i + 1]) & _MASK, (c + words[i + 2]) & _MASK
        # Each step of Jenkins' `mix` and `final` is the one before with a, b and c rotated.
        for bits in (4, 6, 8, 16, 19, 4):
            rotated = (c << bits & _MASK) | c >> (32 - bits)
            a, b, c = b, (c + b) & _MASK, ((a - c) & _MASK) ^ rotated
    a, b, c = a + words[last], b + words[last + 1], c + words[last + 2]
    a, b, c = a & _MASK, b & _MASK, c & _MASK
    for bits in (14, 11, 25, 16, 4, 14, 24):
        rotated = (b << bits & _MASK) | b >> (32 - bits)
        a, b, c = b, ((c ^ b) - rotated) & _MASK, a
    return int(b)


# Of a chunk file only the sizes of the returns differ from those of the file before.
_known_sum = lru_cache(maxsize=256)(_sum_of)


def fletcher32(content: bytes | memoryview | NDArray[Any]) -> int:
    """Return HDF5's Fletcher checksum of bytes: of big-endian 16-bit words, modulo 65535.

    A sum that is a multiple of 65535 is 65535, unless all words are 0.
    """
    raw = np.frombuffer(content, np.uint8)
    words = raw[: len(raw) // 2 * 2].view("<u2")
    first = second = 0
    for begin in range(0, len(words), _PIECE):
        piece = words[begin : begin + _PIECE]
        total, later = _sums(piece)
        second += len(piece) * first + later
        first += total
    # To swap the bytes of a word is to multiply it by 256, modulo 65535.
    first, second = 256 * first, 256 * second
    if len(raw) % 2:
        first += int(raw[-1]) << 8
        second += first
    return _folded(second) << 16 | _folded(first)


def _sums(words: NDArray[Any]) -> tuple[int, int]:
    """Return the sum of `w_i` and that of `(n - i) w_i`."""
    rows = len(words) // _ROW
    matrix, rest = words[: rows * _ROW].reshape(rows, _ROW), words[rows * _ROW :].astype(np.int64)
    of_row = np.add.reduce(matrix, axis=1, dtype=np.uint32).astype(np.int64)
    of_column = np.add.reduce(matrix, axis=0, dtype=np.uint32).astype(np.int64)
    total = int(of_row.sum() + rest.sum())
    placed = (
        _ROW * int(of_row @ np.arange(rows))
        + int(of_column @ np.arange(_ROW))
        + int(rest @ np.arange(rows * _ROW, len(words)))
    )
    return total, len(words) * total - placed


def _folded(total: int) -> int:
    return (total - 1) % 65535 + 1 if total else 0
