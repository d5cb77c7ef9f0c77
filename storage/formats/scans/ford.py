"""One scan of the Ford Campus data set from untrusted bytes: `Scan*.mat`.

SciPy reads MATLAB's files, but not safely: it unpacks whatever is claimed, and checks no element's
type (1.17.1), so that a damaged byte can end the process. What a scan needs of the format, level 5,
is small: a struct `SCAN` with matrices of real numbers.
"""

import math
import zlib
from collections.abc import Collection

import numpy as np

from core.arrays import Float32Array
from core.text import count_of
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan
from storage.formats.scans.coordinates import as_float32
from storage.formats.scans.scan_format import ScanFormat

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_STRUCT_CLASS = 2
_NUMBER_CLASSES = range(6, 16)
_COMPLEX = 0x0800
_NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_INT8, _INT32, _UINT32 = 1, 5, 6


class FordFormat(ScanFormat):
    """Ford's `.mat`; the laser's own axes are kept, x to the right of the truck."""

    name = "Ford Campus"
    media_type = "application/vnd.tensormap.ford"
    suffixes = (".mat",)
    magics = (b"MATLAB 5.0 MAT-file",)

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres.

        Raises:
            MalformedScan: If there is no struct SCAN with numbers XYZ of shape (3, N).
            TruncatedScan: If an element claims more bytes than the body has.
            ScanTooLarge: If the elements would unpack to more than allowed.
        """
        return points_m_of(scan_matrices(body, {"XYZ"}))


def scan_matrices(body: bytes, fields: Collection[str]) -> dict[str, np.ndarray]:
    """Return those of these fields that the struct SCAN has, each with two axes.

    Raises:
        MalformedScan: If there is no struct SCAN, or one of the fields is no matrix of numbers.
        TruncatedScan: If an element claims more bytes than the body has.
        ScanTooLarge: If the elements would unpack to more than allowed.
    """
    if len(body) < _HEADER_BYTES:
        size = count_of(len(body), "byte")
        raise TruncatedScan(f"the body has {size}, the header takes {_HEADER_BYTES}")
    order = {b"IM": "<", b"MI": ">"}.get(body[126:128])
    if not body.startswith(b"MATLAB 5.0") or order is None:
        raise MalformedScan(f"the body begins with {body[:10]!r}, wanted a MATLAB 5.0 MAT-file")
    elements = _Elements(memoryview(body)[_HEADER_BYTES:], order)
    left_bytes = BUDGET.unpacked_bytes
    for _ in range(BUDGET.elements):
        if not elements:
            raise MalformedScan("the file has no struct SCAN")
        kind, content = elements.take()
        if kind == _COMPRESSED:
            unpacked = _unpacked(content, left_bytes)
            left_bytes -= len(unpacked)
            kind, content = _Elements(unpacked, order).take()
        if kind == _MATRIX:
            found = _matrices(_Elements(content, order), fields)
            if found is not None:
                return found
    raise MalformedScan(f"the first {BUDGET.elements} elements are no struct SCAN")


def points_m_of(matrices: dict[str, np.ndarray]) -> Float32Array:
    """Return the `(n, 3)` metres of the matrix XYZ.

    Raises:
        MalformedScan: If there is none, or it is not of shape (3, n).
        ScanTooLarge: If it has more returns than allowed.
    """
    if "XYZ" not in matrices:
        raise MalformedScan("SCAN has no field XYZ")
    xyz = matrices["XYZ"]
    if len(xyz) != 3:
        raise MalformedScan(f"SCAN.XYZ has shape {xyz.shape}, wanted (3, N)")
    BUDGET.require_returns(xyz.shape[1])
    return as_float32(xyz.T)


def _unpacked(packed: memoryview, left_bytes: int) -> memoryview:
    unpacker = zlib.decompressobj()
    try:
        content = unpacker.decompress(packed, left_bytes + 1)
    except zlib.error as error:
        raise MalformedScan(f"an element does not unpack: {error}") from error
    if len(content) > left_bytes:
        raise ScanTooLarge(f"the elements unpack to more than {BUDGET.unpacked_bytes} bytes")
    return memoryview(content)


class _Elements:
    """The elements of a part of a file, in their order."""

    def __init__(self, content: memoryview, order: str) -> None:
        self._content = content
        self.order = order

    def __bool__(self) -> bool:
        return len(self._content) > 0

    def take(self) -> tuple[int, memoryview]:
        """Return the next element's type and its content."""
        if len(self._content) < 8:
            raise TruncatedScan(f"an element takes at least 8 bytes, {len(self._content)} are left")
        first, size = np.frombuffer(self._content[:8], dtype=f"{self.order}u4").tolist()
        if first >> 16:  # up to four bytes follow their type and size directly
            kind, size, start, end = first & 0xFFFF, first >> 16, 4, 8
            if size > 4:
                raise MalformedScan(f"a small element claims {size} bytes")
        else:
            kind, start = first, 8
            # Only compressed elements are not padded.
            end = start + size + (-size % 8 if kind != _COMPRESSED else 0)
        if start + size > len(self._content):
            raise TruncatedScan(f"an element claims {size} bytes, {len(self._content)} are left")
        content = self._content[start : start + size]
        self._content = self._content[end:]
        return kind, content

    def numbers(self, *kinds: int) -> np.ndarray:
        """Return the next element, which must be of one of these types of numbers."""
        kind, content = self.take()
        if kind not in kinds:
            raise MalformedScan(f"an element has type {kind}, wanted one of {kinds}")
        dtype = np.dtype(self.order + _NUMBERS[kind])
        if len(content) % dtype.itemsize:
            raise MalformedScan(f"{len(content)} bytes are no whole number of {dtype}")
        return np.frombuffer(content, dtype=dtype)


def _matrices(elements: _Elements, fields: Collection[str]) -> dict[str, np.ndarray] | None:
    """Return these fields of a variable if it is the struct SCAN."""
    kind, _, shape, name = _start(elements)
    if name != b"SCAN":
        return None
    if kind != _STRUCT_CLASS or shape != [1, 1]:
        raise MalformedScan(f"SCAN is of class {kind} and shape {shape}, wanted one struct")
    length = elements.numbers(_INT32)
    names = elements.numbers(_INT8).tobytes()
    if len(length) != 1 or not 0 < length[0] <= 64 or len(names) % length[0]:
        raise MalformedScan("the names of SCAN's fields cannot be read")
    step = int(length[0])
    if len(names) > BUDGET.elements * step:
        raise MalformedScan(f"SCAN has {len(names) // step} fields, at most {BUDGET.elements}")
    found: dict[str, np.ndarray] = {}
    for at in range(0, len(names), step):
        field = names[at : at + step].rstrip(b"\0").decode("latin-1")
        outer, content = elements.take()
        if outer != _MATRIX:
            raise MalformedScan(f"field {field!r} of SCAN has type {outer}, wanted a matrix")
        if field in fields:
            found[field] = _numbers(_Elements(content, elements.order), field)
            if len(found) == len(fields):
                break
    return found


def _numbers(elements: _Elements, field: str) -> np.ndarray:
    kind, flags, shape, _ = _start(elements)
    if kind not in _NUMBER_CLASSES or flags & _COMPLEX:
        raise MalformedScan(f"SCAN.{field} is of class {kind}, wanted real numbers")
    if len(shape) != 2 or min(shape) < 0:
        raise MalformedScan(f"SCAN.{field} has {len(shape)} axes {shape[:2]}, wanted a matrix")
    values = elements.numbers(*_NUMBERS)
    if len(values) != math.prod(shape):
        raise TruncatedScan(f"SCAN.{field} has shape {shape} and {len(values)} numbers")
    return values.reshape(shape, order="F")


def _start(elements: _Elements) -> tuple[int, int, list[int], bytes]:
    """Return a matrix's class, flags, shape and name."""
    flags = elements.numbers(_UINT32)
    if len(flags) != 2:
        raise MalformedScan(f"a matrix has {len(flags)} flags, wanted 2")
    shape = elements.numbers(_INT32).tolist()
    name = elements.numbers(_INT8).tobytes()
    return int(flags[0]) & 0xFF, int(flags[0]), shape, name
