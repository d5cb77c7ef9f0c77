"""Columns of numbers in text."""

from collections.abc import Iterator, Sequence

import numpy as np

from core.arrays import Float32Array
from storage.formats.errors import MalformedScan

__all__ = ["text_columns"]

# A line that is taken apart needs some thirty times its bytes.
_BLOCK_BYTES = 2**20


def text_columns(
    text: memoryview, columns: Sequence[int], width: int, delimiter: str | None
) -> Float32Array:
    """Read three columns of lines of numbers; empty lines are passed over.

    Args:
        text: One return a line.
        columns: Which three.
        width: How many columns a line has.
        delimiter: What stands between them; `None` is white space.

    Returns:
        `(n, 3)` float32; what is beyond it is infinite.

    Raises:
        MalformedScan: If a line has other columns, or something that is no number in one of them.
    """
    separator = None if delimiter is None else delimiter.encode()
    parts: list[Float32Array] = [np.empty((0, 3), np.float32)]
    for block in _blocks(text):
        rows = []
        for line in block.splitlines():
            if not line or line.isspace():
                continue
            row = line.split(separator)
            if len(row) != width:
                raise MalformedScan(f"wanted {width} columns, {len(row)} came: {line[:80]!r}")
            rows.append([row[column] for column in columns])
        try:
            values = [[float(word) for word in row] for row in rows]
        except ValueError as error:
            raise MalformedScan(f"a coordinate is no number: {str(error)[:120]}") from error
        with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinite: no return
            parts.append(np.array(values, dtype=np.float64).reshape(-1, 3).astype(np.float32))
    return np.concatenate(parts)


def _blocks(text: memoryview) -> Iterator[bytes]:
    """Cut text into blocks of whole lines."""
    start = 0
    while start < len(text):
        block = bytes(text[start : start + _BLOCK_BYTES])
        if start + len(block) < len(text):
            end = block.rfind(b"\n") + 1
            if not end:
                raise MalformedScan(f"a line has more than {_BLOCK_BYTES} bytes")
            block = block[:end]
        yield block
        start += len(block)
