"""Stanford polygon files, `.ply`: ASCII, and binary of both endians.

The maintained library for them has a licence that this project cannot use, and the part that a scan
needs is small: the fixed-size properties of the element `vertex`, which must be the first.
"""

from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, WrongDtype, short
from storage.formats.scans.coordinates import AXES, coordinates, require_amount
from storage.formats.scans.scan_format import ScanFormat
from storage.formats.scans.text_numbers import text_columns

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ENDIANS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_MAX_HEADER_BYTES = 16_384
_MAX_PROPERTIES = 1024
_SEARCHED_BYTES = 2**20


class PlyFormat(ScanFormat):
    """PLY; elements but `vertex` are skipped, and so are its properties but x, y and z."""

    name = "PLY"
    media_type = "application/vnd.tensormap.ply"
    suffixes = (".ply",)
    magics = (b"ply\n", b"ply\r\n")

    def read(self, body: bytes) -> Float32Array:
        r"""Return `(n, 3)` metres.

        Raises:
            MalformedScan: If header or vertices cannot be parsed or do not agree.
            TruncatedScan: If the header claims more than the body has.
            WrongDtype: If x, y or z is not a float.

        Examples:
            >>> head = "ply\nformat ascii 1.0\nelement vertex 1\n"
            >>> axes = "property float x\nproperty float y\nproperty float z\nend_header\n"
            >>> PlyFormat().read(f"{head}{axes}10 0 -1\n".encode())
            array([[10.,  0., -1.]], dtype=float32)
        """
        header, start = _read_header(body)
        vertex, vertices = header.vertex, header.vertices
        if header.is_text:
            columns = [header.names.index(axis) for axis in AXES]
            end = len(body) if header.is_last else _end_of_lines(body, start, vertices)
            lines, first_line = memoryview(body)[start:end], body.count(b"\n", 0, start) + 1
            width = len(header.names)
            returns_m = text_columns(lines, columns, width, None, first_line=first_line)
            message = f"the header claims {vertices:.6g} vertices, got {len(returns_m)}"
            require_amount(len(returns_m), vertices, message)
            return returns_m
        claimed, given = vertices * vertex.itemsize, len(body) - start
        claim = f"{vertices:.6g} vertices of {vertex.itemsize} bytes take {claimed:.6g}"
        of_vertices = given if header.is_last else min(given, claimed)
        require_amount(of_vertices, claimed, f"{claim}, got {given}")
        BUDGET.require_returns(vertices)
        return coordinates(np.frombuffer(body, dtype=vertex, count=vertices, offset=start))


@dataclass(frozen=True)
class _Header:
    is_text: bool
    vertices: int
    vertex: np.dtype[np.void]
    is_last: bool

    @property
    def names(self) -> tuple[str, ...]:
        return self.vertex.names or ()


def _read_header(body: bytes) -> tuple[_Header, int]:
    """Return the header and where the vertices begin."""
    lines, start = _lines(body)
    if lines[0] != ["ply"]:
        raise MalformedScan(f"the body begins with {body[:8]!r}, .ply with 'ply'")
    match lines[1]:
        case ["format", encoding, "1.0"] if encoding in _ENDIANS:
            pass
        case _:
            raise MalformedScan(f"line 2 is {short(lines[1])}, wanted format ENCODING 1.0")
    elements = [number for number, line in enumerate(lines) if line[0] == "element"]
    match lines[elements[0]] if elements else []:
        case ["element", "vertex", digits] if digits.isdecimal() and len(digits) <= 15:
            pass
        case other:
            raise MalformedScan(f"the first element is {short(other)}, wanted element vertex N")
    end = elements[1] if len(elements) > 1 else len(lines)
    codes: dict[str, str] = {}
    for line in lines[elements[0] + 1 : end]:
        match line:
            case ["property", kind, name] if kind in _TYPES and name not in codes:
                codes[name] = _TYPES[kind]
            case ["property", "list", *_]:
                raise MalformedScan(
                    f"{short(line)} gives each vertex a list, wanted properties of fixed size"
                )
            case _:
                raise MalformedScan(f"{short(line)} is no property of fixed size with a new name")
    if len(codes) > _MAX_PROPERTIES:
        raise MalformedScan(f"wanted at most {_MAX_PROPERTIES} properties, got {len(codes)}")
    for axis in AXES:
        if (code := codes.get(axis, "nothing")) not in {"f4", "f8"}:
            raise WrongDtype(f"property {axis} holds {code}, wanted float or double")
    vertex = np.dtype([(name, _ENDIANS[encoding] + code) for name, code in codes.items()])
    return _Header(encoding == "ascii", int(digits), vertex, len(elements) == 1), start


def _lines(body: bytes) -> tuple[list[list[str]], int]:
    found: list[list[str]] = []
    start = 0
    while True:
        end = body.find(b"\n", start, _MAX_HEADER_BYTES)
        if end < 0:
            searched = min(len(body), _MAX_HEADER_BYTES)
            if body[:4] == b"ply\r" and body[4:5] != b"\n":
                raise MalformedScan(
                    "the header's lines end in carriage returns only, wanted newlines: convert the"
                    " file's line ends"
                )
            raise MalformedScan(f"no end_header in the first {searched} bytes")
        words = body[start:end].decode("latin-1").split()
        start = end + 1
        if words == ["end_header"]:
            break
        if words and words[0] not in {"comment", "obj_info"}:
            found.append(words)
    if len(found) < 2:
        raise MalformedScan("the header has no format and no elements")
    return found, start


def _end_of_lines(body: bytes, start: int, count: int) -> int:
    """Return where `count` lines that are not blank end, or the end of the body if it has fewer."""
    is_begun = False  # whether a line of the block before goes on, with something in it
    while count and start < len(body):
        block = np.frombuffer(body, np.uint8, min(_SEARCHED_BYTES, len(body) - start), start)
        ends = np.flatnonzero(block == ord("\n"))
        inside = np.cumsum(block > ord(" "), dtype=np.int32)
        filled = np.diff(inside[ends], prepend=0) > 0
        filled[:1] |= is_begun
        found = ends[filled]
        if len(found) >= count:
            return start + int(found[count - 1]) + 1
        count -= len(found)
        is_begun = bool(inside[-1] > inside[ends[-1]]) if len(ends) else is_begun or inside[-1] > 0
        start += len(block)
    return start
