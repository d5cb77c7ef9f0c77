"""Columns of numbers in text, block by block, in time linear in its length."""

import io
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from core.arrays import Float32Array, FloatArray
from core.errors import TensorMapError
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge
from storage.formats.scans.coordinates import as_float32

_BLOCK_BYTES = 2**20
_NEWLINE, _BLANK = ord("\n"), ord(" ")
# Other characters are replaced by one that no parser takes for white space or a digit.
_PLAIN = bytes(code if code in b"\t\n\v\f" or 32 <= code < 127 else ord("?") for code in range(256))


def text_columns(
    text: memoryview,
    columns: Sequence[int],
    width: int,
    delimiter: str | None,
    *,
    first_line: int,
) -> Float32Array:
    """Read three columns of lines of numbers; empty lines are ignored.

    A line with nothing in all three is a no-return, as pandas writes one.

    Args:
        text: One return a line.
        columns: Which three.
        width: Number of columns of a line.
        delimiter: The character between them; `None` is white space.
        first_line: The number of the text's first line in its file.

    Returns:
        `(n, 3)` float32; what is beyond it is infinite.

    Raises:
        MalformedScan: If a line has another number of columns, or a column is no number; it names
            the line.
        ScanTooLarge: If there are more bytes or lines than a scan may have.
    """
    if len(text) > BUDGET.text_bytes:
        raise ScanTooLarge(f"the lines have {len(text)} bytes, at most {BUDGET.text_bytes}")
    read = partial(number_rows, columns=columns, width=width, delimiter=delimiter)
    parts: list[Float32Array] = [np.empty((0, 3), np.float32)]
    lines = 0
    for block in blocks_of_lines(text, _BLOCK_BYTES):
        if block is None:
            raise MalformedScan(f"a line has more than {_BLOCK_BYTES} bytes")
        before, lines = lines, lines + block.count(b"\n")
        if lines > BUDGET.text_returns:
            raise ScanTooLarge(f"the scan has more than {BUDGET.text_returns} lines")
        try:
            values = read(block)
        except ValueError:
            block = _with_no_returns(block, columns, delimiter)
            try:
                values = read(block)
            except ValueError as error:
                at, wrong = wrong_line(block, read, error)
                raise MalformedScan(f"line {first_line + before + at}: {wrong}") from error
        parts.append(as_float32(values))
    return np.concatenate(parts)


def wrong_line(
    block: bytes, read: Callable[[bytes], object], wrong: Exception
) -> tuple[int, Exception]:
    """Find the first wrong line of a block by bisection.

    Args:
        block: Whole lines that cannot be read.
        read: Reads some of them, or raises.
        wrong: What it raised of the block.

    Returns:
        The number of lines before that line, and what `read` raises of it.
    """
    lines, at = block.splitlines(keepends=True), 0
    while len(lines) > 1:
        half = lines[: len(lines) // 2]
        try:
            read(b"".join(half))
        except (TensorMapError, ValueError) as error:
            wrong, lines = error, half
        else:
            at, lines = at + len(half), lines[len(half) :]
    return at, wrong


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
        reason = str(error).partition(" at row ")[0]  # of these lines, not of the file's
        raise ValueError(f"a coordinate is no number: {reason[:120]}") from error


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


def _with_no_returns(block: bytes, columns: Sequence[int], delimiter: str | None) -> bytes:
    """Return lines with NaN in these columns where there is nothing in each of them."""
    if delimiter is None:
        return block
    separator = delimiter.encode()
    blank = b" *" if delimiter == "\t" else b"[ \t]*"
    begin, filled, at, groups = b"\n", b"\n", 0, 0  # found faster than the begin of a line
    for column in sorted(columns):
        if column > at:  # the columns between, with the separators that end them
            groups += 1
            begin += b"((?:[^%b\n]*%b){%d})" % (separator, separator, column - at)
            filled += b"\\%d" % groups
        last = column == max(columns)
        begin += blank + (b"(?=[%b\n])" if last else b"%b") % separator
        filled += b"nan" + (b"" if last else separator)
        at = column + 1
    return re.sub(begin, filled, b"\n" + block)[1:]


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
