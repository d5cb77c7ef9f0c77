"""One scan of the Ford Campus data set from bytes that anybody may have sent: `Scan*.mat`.

SciPy reads MATLAB's files and must not be given a stranger's: it unpacks whatever is claimed, and
checks no element's type (1.17.1), so that a damaged byte can end the process. What a scan needs of
the format, level 5, is small: a struct `SCAN` with a matrix `XYZ` of real numbers.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan

__all__ = ["FordFormat"]

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_STRUCT_CLASS = 2
_NUMBER_CLASSES = range(6, 16)
_COMPLEX = 0x0800
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_INT8, _INT32, _UINT32 = 1, 5, 6


@dataclass(frozen=True)
class FordFormat:
    """Ford's `.mat`; the laser's own axes are kept, x to the right of the truck.

    Attributes:
        max_decoded_bytes: What the compressed elements of a file may unpack to, all together.
    """

    name: str = "Ford Campus"
    media_type: str = "application/vnd.tensormap.ford"
    suffixes: tuple[str, ...] = (".mat",)
    magics: tuple[bytes, ...] = (b"MATLAB 5.0 MAT-file",)
    max_decoded_bytes: int = BUDGET.unpacked_bytes

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres.

        Raises:
            MalformedScan: If there is no struct SCAN with numbers XYZ of shape (3, N).
            TruncatedScan: If an element claims more bytes than came.
            ScanTooLarge: If an element would unpack to more than `max_decoded_bytes`.
        """
        if len(body) < _HEADER_BYTES:
            raise TruncatedScan(f"{len(body)} bytes came, the header takes {_HEADER_BYTES}")
        order = {b"IM": "<", b"MI": ">"}.get(body[126:128])
        if not body.startswith(b"MATLAB 5.0") or order is None:
            raise MalformedScan(f"the body begins with {body[:10]!r}, wanted a MATLAB 5.0 MAT-file")
        elements = _Elements(memoryview(body)[_HEADER_BYTES:], order)
        left_bytes = self.max_decoded_bytes
        for _ in range(BUDGET.elements):
            if not elements:
                raise MalformedScan("the file has no struct SCAN")
            kind, content = elements.take()
            if kind == _COMPRESSED:
                unpacked = self._unpacked(content, left_bytes)
                left_bytes -= len(unpacked)
                kind, content = _Elements(unpacked, order).take()
            if kind == _MATRIX:
                found = _scan_matrix(_Elements(content, order))
                if found is not None:
                    return found
        raise MalformedScan(f"the first {BUDGET.elements} elements are no struct SCAN")

    def _unpacked(self, packed: memoryview, most_bytes: int) -> memoryview:
        unpacker = zlib.decompressobj()
        try:
            content = unpacker.decompress(packed, most_bytes + 1)
        except zlib.error as error:
            raise MalformedScan(f"an element does not unpack: {error}") from error
        if len(content) > most_bytes:
            raise ScanTooLarge(
                f"the elements unpack to more than the {self.max_decoded_bytes} bytes that may be"
            )
        return memoryview(content)


class _Elements:
    """The elements of a part of a file, one after the other."""

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
        if first >> 16:  # up to four bytes stand beside their type and size
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

    def numbers(self, *wanted: int) -> np.ndarray:
        """Return the next element, which must be of one of these types of numbers."""
        kind, content = self.take()
        if kind not in wanted:
            raise MalformedScan(f"an element has type {kind}, wanted one of {wanted}")
        dtype = np.dtype(self.order + _NUMBERS[kind])
        if len(content) % dtype.itemsize:
            raise MalformedScan(f"{len(content)} bytes are no whole number of {dtype}")
        return np.frombuffer(content, dtype=dtype)


def _scan_matrix(elements: _Elements) -> Float32Array | None:
    """Return the points of a variable if it is the struct SCAN."""
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
        raise MalformedScan(
            f"SCAN has {len(names) // step} fields, at most {BUDGET.elements} may be"
        )
    fields = [names[at : at + step].rstrip(b"\0") for at in range(0, len(names), step)]
    for field in fields:
        outer, content = elements.take()
        if outer != _MATRIX:
            raise MalformedScan(f"field {field!r} of SCAN has type {outer}, wanted a matrix")
        if field == b"XYZ":
            return _points(_Elements(content, elements.order))
    raise MalformedScan("SCAN has no field XYZ")


def _points(elements: _Elements) -> Float32Array:
    kind, flags, shape, _ = _start(elements)
    if kind not in _NUMBER_CLASSES or flags & _COMPLEX:
        raise MalformedScan(f"SCAN.XYZ is of class {kind}, wanted real numbers")
    if len(shape) != 2 or shape[0] != 3:
        raise MalformedScan(f"SCAN.XYZ has shape {shape}, wanted (3, N)")
    values = elements.numbers(*_NUMBERS)
    if len(values) != shape[0] * shape[1]:
        raise TruncatedScan(f"SCAN.XYZ has shape {shape} and {len(values)} numbers")
    BUDGET.require_returns(shape[1])
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinite: no return
        return values.reshape(-1, 3).astype(np.float32)  # by columns, as MATLAB writes


def _start(elements: _Elements) -> tuple[int, int, list[int], bytes]:
    """Return a matrix's class, flags, shape and name."""
    flags = elements.numbers(_UINT32)
    if len(flags) != 2:
        raise MalformedScan(f"a matrix has {len(flags)} flags, wanted 2")
    shape = elements.numbers(_INT32).tolist()
    name = elements.numbers(_INT8).tobytes()
    return int(flags[0]) & 0xFF, int(flags[0]), shape, name
