"""Columns of numbers in text, block by block, in time linear in its length."""

import io
from collections.abc import Iterator, Sequence

import numpy as np

from core.arrays import Float32Array, FloatArray
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge
from storage.formats.scans.coordinates import as_float32

_BLOCK_BYTES = 2**20
_NEWLINE, _BLANK = ord("\n"), ord(" ")
# Other characters are replaced by one that no parser takes for white space or a digit.
_PLAIN = bytes(code if code in b"\t\n\v\f" or 32 <= code < 127 else ord("?") for code in range(256))


def text_columns(
    text: memoryview, columns: Sequence[int], width: int, delimiter: str | None
) -> Float32Array:
    """Read three columns of lines of numbers; empty lines are ignored.

    Args:
        text: One return a line.
        columns: Which three.
        width: Number of columns of a line.
        delimiter: The character between them; `None` is white space.

    Returns:
        `(n, 3)` float32; what is beyond it is infinite.

    Raises:
        MalformedScan: If a line has another number of columns, or a column is no number.
        ScanTooLarge: If there are more bytes or lines than a scan may have.
    """
    if len(text) > BUDGET.text_bytes:
        raise ScanTooLarge(f"the lines have {len(text)} bytes, at most {BUDGET.text_bytes}")
    parts: list[Float32Array] = [np.empty((0, 3), np.float32)]
    lines = 0
    for block in blocks_of_lines(text, _BLOCK_BYTES):
        if block is None:
            raise MalformedScan(f"a line has more than {_BLOCK_BYTES} bytes")
        lines += block.count(b"\n")
        if lines > BUDGET.text_returns:
            raise ScanTooLarge(f"the scan has more than {BUDGET.text_returns} lines")
        try:
            values = number_rows(block, columns, width, delimiter)
        except ValueError as error:
            raise MalformedScan(str(error)) from error
        parts.append(as_float32(values))
    return np.concatenate(parts)


def number_rows(
    block: bytes, columns: Sequence[int], width: int, delimiter: str | None
) -> FloatArray:
    """Return some columns of a block of whole lines, `(n, columns)`; blank lines give no row.

    Args:
        block: Lines that end in newlines.
        columns: Which columns; rows have them in this order.
        width: Number of columns that every line must have.
        delimiter: One character, or `None` for white space.

    Raises:
        ValueError: If a line has another width, or a column is no number; the message says which.
    """
    if not _has_width(block, width, delimiter):
        block = b"".join(_of_width(block, width, delimiter))
    if not block:
        return np.empty((0, len(columns)))
    plain = block.translate(_PLAIN).decode("ascii")
    try:
        return np.loadtxt(
            io.StringIO(plain), delimiter=delimiter, usecols=columns, comments=None, ndmin=2
        )
    except ValueError as error:
        raise ValueError(f"a coordinate is no number: {str(error)[:120]}") from error


def blocks_of_lines(text: memoryview, most_bytes: int) -> Iterator[bytes | None]:
    """Yield text in blocks of whole lines that end in newlines; `None` where a line is longer."""
    start = 0
    while start < len(text):
        block = bytes(text[start : start + most_bytes])
        if start + len(block) < len(text):
            # A carriage return at the very end may be half of a line's end.
            end = max(block.rfind(b"\n"), block.rfind(b"\r", 0, len(block) - 1)) + 1
            if not end:
                yield None
                return
            block = block[:end]
        start += len(block)
        if b"\r" in block:
            block = block.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        yield block if block.endswith(b"\n") else block + b"\n"


def _has_width(block: bytes, width: int, delimiter: str | None) -> bool:
    """Return whether every line has so many columns; a blank line has another number of them."""
    codes = np.frombuffer(block, np.uint8)
    if delimiter is None:
        inside = codes > _BLANK
        begins = inside.copy()
        begins[1:] &= ~inside[:-1]
        expected = width
    else:
        begins = codes == ord(delimiter)
        expected = width - 1
    before = np.cumsum(begins, dtype=np.int32)[codes == _NEWLINE]
    has_blank_line = block.startswith(b"\n") or b"\n\n" in block
    has_width = bool((np.diff(before, prepend=0) == expected).all())
    return has_width and (expected > 0 or not has_blank_line)


def _of_width(block: bytes, width: int, delimiter: str | None) -> Iterator[bytes]:
    """Yield the lines that are not blank, each with its width checked."""
    separator = None if delimiter is None else delimiter.encode()
    for line in block.split(b"\n"):
        if not line or line.isspace():
            continue
        found = len(line.split(separator))
        if found != width:
            raise ValueError(f"wanted {width} columns, got {found}: {line[:80]!r}")
        yield line + b"\n"
