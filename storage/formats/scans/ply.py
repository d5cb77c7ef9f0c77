"""Stanford polygon files, `.ply`: ASCII, and binary of both endians.

The kept-up library for them is under a licence that this project cannot take, and the part that a
scan needs is small: the fixed-size properties of the element `vertex`, which must come first.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, WrongDtype, short
from storage.formats.scans.coordinates import AXES, coordinates, require_amount
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
_SOUGHT_BYTES = 2**20


@dataclass(frozen=True)
class PlyFormat:
    """PLY; elements but `vertex` are skipped, and so are its properties but x, y and z."""

    name: str = "PLY"
    media_type: str = "application/vnd.tensormap.ply"
    suffixes: tuple[str, ...] = (".ply",)
    magics: tuple[bytes, ...] = (b"ply\n", b"ply\r\n")

    def read(self, body: bytes) -> Float32Array:
        r"""Return `(n, 3)` metres.

        Raises:
            MalformedScan: If header or vertices cannot be parsed or do not agree.
            TruncatedScan: If the header claims more than came.
            WrongDtype: If x, y or z is not a float.

        Examples:
            >>> head = "ply\nformat ascii 1.0\nelement vertex 1\n"
            >>> axes = "property float x\nproperty float y\nproperty float z\nend_header\n"
            >>> PlyFormat().read(f"{head}{axes}10 0 -1\n".encode())
            array([[10.,  0., -1.]], dtype=float32)
        """
        header, start = _read_header(body)
        if header.encoding == "ascii":
            columns = [header.names.index(axis) for axis in AXES]
            end = len(body) if header.is_last else _end_of_lines(body, start, header.vertices)
            text = memoryview(body)[start:end]
            returns_m = text_columns(text, columns, len(header.names), None)
            told = f"the header claims {header.vertices:.6g} vertices, {len(returns_m)} came"
            require_amount(len(returns_m), header.vertices, told)
            return returns_m
        dtype = np.dtype(
            [
                (name, _ENDIANS[header.encoding] + code)
                for name, code in zip(header.names, header.codes, strict=True)
            ]
        )
        wanted, came = header.vertices * dtype.itemsize, len(body) - start
        told = f"{header.vertices:.6g} vertices of {dtype.itemsize} bytes take {wanted:.6g}"
        came_of_them = came if header.is_last else min(came, wanted)
        require_amount(came_of_them, wanted, f"{told}, {came} came")
        BUDGET.require_returns(header.vertices)
        vertices = np.frombuffer(body, dtype=dtype, count=header.vertices, offset=start)
        return coordinates(vertices)


@dataclass(frozen=True)
class _Header:
    encoding: str
    vertices: int
    names: tuple[str, ...]
    codes: tuple[str, ...]
    is_last: bool


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
    names, codes = [], []
    for line in lines[elements[0] + 1 : end]:
        match line:
            case ["property", kind, name] if kind in _TYPES:
                names.append(name)
                codes.append(_TYPES[kind])
            case _:
                raise MalformedScan(f"{short(line)} is no property of fixed size")
    if len(set(names)) != len(names) or len(names) > _MAX_PROPERTIES:
        raise MalformedScan(f"wanted at most {_MAX_PROPERTIES} properties, no name twice")
    for axis in AXES:
        code = codes[names.index(axis)] if axis in names else "nothing"
        if code not in {"f4", "f8"}:
            raise WrongDtype(f"property {axis} holds {code}, wanted float or double")
    header = _Header(encoding, int(digits), tuple(names), tuple(codes), len(elements) == 1)
    return header, start


def _lines(body: bytes) -> tuple[list[list[str]], int]:
    found: list[list[str]] = []
    start = 0
    for _ in itertools.count():
        end = body.find(b"\n", start, _MAX_HEADER_BYTES)
        if end < 0:
            came = min(len(body), _MAX_HEADER_BYTES)
            raise MalformedScan(f"no end_header in the first {came} bytes")
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
    """Return where `count` lines end; of more lines than there are, the end of the body."""
    while start < len(body):
        block = np.frombuffer(body, np.uint8, min(_SOUGHT_BYTES, len(body) - start), start)
        ends = np.flatnonzero(block == ord("\n"))
        if len(ends) >= count:
            return start + (int(ends[count - 1]) + 1 if count else 0)
        count -= len(ends)
        start += len(block)
    return len(body)
