"""Points as text, `.csv`: a line for each return, with or without a header of names."""

import re

from core.arrays import Float32Array
from core.text import count_of
from storage.formats.errors import MalformedScan
from storage.formats.scans.coordinates import AXES
from storage.formats.scans.scan_format import ScanFormat
from storage.formats.scans.text_numbers import text_columns

_DELIMITERS = (",", ";", "\t", " ")
_LINE_END = re.compile(rb"\r\n?|\n")
_UNIT = re.compile(r"[(\[]")
_METRES = ("m", "metre", "metres", "meter", "meters")
# Behind the name of a column, and no column of its own as (refl).
_UNIT_WORD = re.compile(r"[(\[](\w{1,3}(/\w{1,3})?|met(re|er)s?)[)\]]", re.IGNORECASE)
_MAX_LINE_BYTES = 16_384


class CsvFormat(ScanFormat):
    """CSV: the columns named x, y and z, in any order, or the first three if none is named.

    A column's name may have its unit after it, metres, as `x (m)`, `x [m]` or `x_m`. A `#` or `//`
    before the names is left out: NumPy and CloudCompare write them. Columns end at commas,
    semicolons, tabs or spaces, whichever of them the first line has, in this order.
    """

    name = "CSV"
    media_type = "application/vnd.tensormap.csv"
    suffixes = (".csv",)
    magics = (b"x,y,z", b"X,Y,Z")

    def read(self, body: bytes) -> Float32Array:
        r"""Return `(n, 3)` metres.

        Raises:
            MalformedScan: If there is no column x, y or z, one is not in metres, a line has other
                columns than the first, or a coordinate is no number.

        Examples:
            >>> CsvFormat().read(b"i,z,y,x\n7,-1,0,10\n")
            array([[10.,  0., -1.]], dtype=float32)
        """
        text = body.removeprefix(b"\xef\xbb\xbf")  # spreadsheets mark UTF-8 so
        if b"\0" in text[:_MAX_LINE_BYTES]:
            raise MalformedScan("the body is no text: it has zero bytes")
        text = text.lstrip(b" \r\n")  # a tab may end a first column without a name
        blank = body[: len(body) - len(text)]
        line = 1 + blank.count(b"\n") + blank.count(b"\r") - blank.count(b"\r\n")
        end = _LINE_END.search(text[:_MAX_LINE_BYTES])
        head = text[: end.start()] if end else text[:_MAX_LINE_BYTES]
        if not end and len(text) > _MAX_LINE_BYTES:
            raise MalformedScan(f"the first line has more than {_MAX_LINE_BYTES} bytes")
        first = head.decode("latin-1").rstrip()
        first = first.removeprefix("#").removeprefix("//").lstrip(" ")
        delimiter = next((d for d in _DELIMITERS if d in first), None)
        if delimiter is None:
            raise MalformedScan(f"the first line is {first[:80]!r}, wanted columns x, y and z")
        separator = None if delimiter == " " else delimiter
        # A tab that ends each line ends a column without a name, as a comma does.
        tabs = len(head) - len(head.rstrip(b"\t")) if delimiter == "\t" else 0
        names = first.split(separator) + [""] * tabs if separator else _words(first)
        if _is_number(names[0]):
            if len(names) < 3:
                found = count_of(len(names), "column")
                raise MalformedScan(f"the first line has {found}, wanted x, y and z")
            return text_columns(memoryview(text), (0, 1, 2), len(names), separator, first_line=line)
        returns = memoryview(text)[end.end() if end else len(text) :]
        columns = _columns(names)
        return text_columns(returns, columns, len(names), separator, first_line=line + 1)


def _words(line: str) -> list[str]:
    """Return what spaces separate, a unit in brackets with the name before it."""
    words: list[str] = []
    for word in line.split():
        if words and _UNIT_WORD.fullmatch(word):
            words[-1] += word
        else:
            words.append(word)
    return words


def _columns(names: list[str]) -> list[int]:
    parts = [_UNIT.split(name.strip().strip("\"'").lower(), maxsplit=1) for name in names]
    plain = [name.strip().removesuffix("_m") for name, *_ in parts]
    for axis in AXES:
        if plain.count(axis) != 1:
            raise MalformedScan(f"wanted one column {axis}, the columns are {str(names)[:120]}")
    columns = [plain.index(axis) for axis in AXES]
    for axis, column in zip(AXES, columns, strict=True):
        unit = "".join(parts[column][1:]).strip(" )]")
        if unit and unit not in _METRES:
            raise MalformedScan(f"column {axis} is in {unit[:80]!r}, wanted metres (m)")
    return columns


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
