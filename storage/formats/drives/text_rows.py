"""Text files of numbers, a row a line; an error names the file and the line."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from core.arrays import FloatArray
from core.numbers import numbers_of
from storage.formats.errors import MalformedDrive

TUM_COLUMNS = 8
"""Values of a line of TUM's form, `t x y z qx qy qz qw`."""


def lines_of(file: Path) -> list[str]:
    """Return the lines of a text file, without blank ones at its end."""
    return lines_in(file.read_bytes())


def lines_in(text: bytes) -> list[str]:
    r"""Return the lines of a text, without blank ones at its end.

    Examples:
        >>> lines_in(b"\xef\xbb\xbf0.0\r\n0.1\n\n")  # editors of Windows write a mark
        ['0.0', '0.1']
    """
    return text.decode("utf-8-sig", "replace").rstrip().splitlines()


def without_comments(lines: Iterable[str]) -> list[tuple[int, str]]:
    """Return lines with their numbers, without comments, which begin with a `#`.

    Lines with nothing but a comment are left out.

    Examples:
        >>> without_comments(["# seconds", "0.0", "0.1 # late"])
        [(2, '0.0'), (3, '0.1 ')]
    """
    return [
        (number, line.partition("#")[0])
        for number, line in enumerate(lines, 1)
        if not line.lstrip().startswith("#")
    ]


def line_numbers(
    file: Path, number: int, line: str, columns: int, separator: str | None = None
) -> FloatArray:
    """Return the numbers of one line, `(columns,)`.

    Args:
        file: The file's name, for messages.
        number: The line's.
        line: Its text.
        columns: How many numbers are wanted.
        separator: What is between them, by default blanks. With one an empty value is NaN, and
            the line may end with one more of it.

    Raises:
        MalformedDrive: If they are more, fewer or no numbers.
    """
    if separator is None:
        words = line.split()
    else:
        words = [word.strip() or "nan" for word in line.split(separator)]
        if len(words) == columns + 1 and not line.rpartition(separator)[2].strip():
            words.pop()
    if len(words) != columns:
        raise MalformedDrive(
            f"{file.name}, line {number}: {len(words)} values, wanted {columns}: {line[:80]!r}"
        )
    try:
        return np.array(numbers_of(words))
    except ValueError as error:
        raise MalformedDrive(f"{file.name}, line {number}: {error}") from error
