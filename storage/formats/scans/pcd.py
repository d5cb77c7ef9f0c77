"""Point Cloud Library files, `.pcd`: ascii, binary and binary_compressed.

The library for them, pypcd4, allocates whatever a header claims, requires lines that are optional
in the format, splits lines by the names of fields, and holds three copies of the points. Only LZF
is needed here, from the library that pypcd4 uses.
"""

import itertools
import math
import operator
from dataclasses import dataclass

import lzf
import numpy as np

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan, WrongDtype, short
from storage.formats.scans.coordinates import (
    AXES,
    as_float32,
    coordinates,
    record_of,
    require_amount,
)
from storage.formats.scans.scan_format import ScanFormat
from storage.formats.scans.text_numbers import text_columns

_SIZES = {"F": {4, 8}, "I": {1, 2, 4, 8}, "U": {1, 2, 4, 8}}
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_KEYS = {
    "VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT",
    "POINTS", "DATA",
}  # fmt: skip
_MAX_HEADER_BYTES = 16_384
_MAX_COLUMNS = 1024  # the longest of PCL's own point types, ESFSignature640, has 640
_LZF_RATIO = 88  # LZF's longest match: 264 bytes out of 3


class PcdFormat(ScanFormat):
    """PCD; all fields but x, y and z are skipped, padding included, and so is the viewpoint."""

    name = "PCD"
    media_type = "application/vnd.tensormap.pcd"
    suffixes = (".pcd",)
    magics = (b"# .PCD", b"VERSION ", b"FIELDS ")

    def read(self, body: bytes) -> Float32Array:
        r"""Return `(n, 3)` metres, including the NaN points of organized clouds.

        Raises:
            MalformedScan: If header or points cannot be parsed or do not agree.
            TruncatedScan: If the header claims more than the body has.
            WrongDtype: If x, y or z is not a float.
            ScanTooLarge: If the points would take more than allowed.

        Examples:
            >>> text = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nDATA ascii\n"
            >>> PcdFormat().read(text.encode() + b"10 0 -1\n")
            array([[10.,  0., -1.]], dtype=float32)
        """
        header, start = _read_header(body)
        points = memoryview(body)[start:]
        if header.size_bytes > BUDGET.decoded_bytes:
            if header.claims_more_than(len(points)):
                raise TruncatedScan(
                    f"the header claims {header.claim}, got {len(points)} bytes of points"
                )
            most = f"at most {BUDGET.decoded_bytes} bytes"
            raise ScanTooLarge(f"the header claims {header.claim}, {most}")
        if header.encoding == "ascii":
            if body.find(b"#", start) >= 0:
                raise MalformedScan("there is a '#' among the ascii points")
            return _text_points(points, header, body.count(b"\n", 0, start) + 1)
        if header.encoding == "binary":
            return _binary_points(points, header)
        return _compressed_points(points, header)


@dataclass(frozen=True)
class _Header:
    """The header's description of the points.

    Attributes:
        record: x, y and z within a binary point.
        offsets: Bytes before x, y and z in a point.
        columns: Columns of x, y and z in a line of text.
        width: Number of columns in a line.
        points: Number of points.
        encoding: How they are written.
    """

    record: np.dtype[np.void]
    offsets: tuple[int, ...]
    columns: tuple[int, ...]
    width: int
    points: int
    encoding: str

    @property
    def size_bytes(self) -> int:
        return self.points * self.record.itemsize

    @property
    def claim(self) -> str:
        return f"{self.points:.6g} points of {self.record.itemsize} bytes ({self.encoding})"

    def claims_more_than(self, given_bytes: int) -> bool:
        """Return whether no body of that length can hold the points."""
        if self.encoding == "ascii":  # a digit and a separator for each value
            return self.points * self.width * 2 > given_bytes + 1
        ratio = _LZF_RATIO if self.encoding == "binary_compressed" else 1
        return self.size_bytes > given_bytes * ratio


def _read_header(body: bytes) -> tuple[_Header, int]:
    """Return the header and where the points begin."""
    entries, start = _entries(body)
    fields = tuple(entries.get("FIELDS") or entries.get("COLUMNS") or ())
    sizes, types = _integers(entries, "SIZE"), tuple(entries.get("TYPE", ()))
    counts = _integers(entries, "COUNT") if "COUNT" in entries else (1,) * len(fields)
    if not fields or not len(fields) == len(sizes) == len(types) == len(counts):
        raise MalformedScan(
            f"the header has {len(fields)} FIELDS, {len(sizes)} SIZE, {len(types)} TYPE and"
            f" {len(counts)} COUNT, wanted as many of each"
        )
    if not all(size in _SIZES.get(kind, ()) for kind, size in zip(types, sizes, strict=True)):
        raise MalformedScan(f"TYPE {short(types)} has no SIZE {short(sizes)}")
    if min(counts) < 1 or sum(counts) > _MAX_COLUMNS:
        raise MalformedScan(f"a point has COUNT {short(counts)}, wanted 1 to {_MAX_COLUMNS} in all")
    for axis in AXES:
        at = fields.index(axis) if fields.count(axis) == 1 else None
        if at is None or counts[at] != 1:
            raise MalformedScan(f"wanted one field {axis} of COUNT 1, FIELDS are {short(fields)}")
        if types[at] != "F":
            raise WrongDtype(f"field {axis} has TYPE {types[at]}, wanted F, metres in 4 or 8 bytes")
    encoding = " ".join(entries["DATA"])
    if encoding not in _ENCODINGS:
        raise MalformedScan(f"DATA is {short(encoding)}, wanted one of {', '.join(_ENCODINGS)}")
    at_xyz = [fields.index(axis) for axis in AXES]
    *columns, width = itertools.accumulate(counts, initial=0)
    *offsets, size = itertools.accumulate(map(operator.mul, sizes, counts), initial=0)
    formats = {axis: (f"<f{sizes[i]}", offsets[i]) for axis, i in zip(AXES, at_xyz, strict=True)}
    header = _Header(
        record_of(formats, size),
        tuple(offsets[i] for i in at_xyz),
        tuple(columns[i] for i in at_xyz),
        width,
        _points(entries),
        encoding,
    )
    return header, start


def _entries(body: bytes) -> tuple[dict[str, list[str]], int]:
    entries: dict[str, list[str]] = {}
    start = 0
    while start < min(len(body), _MAX_HEADER_BYTES):
        end = body.find(b"\n", start, _MAX_HEADER_BYTES)
        end = end if end >= 0 else min(len(body), _MAX_HEADER_BYTES)
        key, *words = body[start:end].decode("latin-1").split() or ["#"]
        start = end + 1
        if not (entries or key.startswith("#") or key in _KEYS):
            raise MalformedScan(
                f"it is no PCD file: it begins with {body[:16]!r}, wanted a header that begins with"
                " '# .PCD' or VERSION"
            )
        if key in entries:
            raise MalformedScan(f"the header has two lines {short(key)}")
        if not key.startswith("#"):
            entries[key] = words
        if key == "DATA":
            return entries, start
    raise MalformedScan(f"no DATA line in the first {min(len(body), _MAX_HEADER_BYTES)} bytes")


def _points(entries: dict[str, list[str]]) -> int:
    sides = [_integer(entries, key) for key in ("WIDTH", "HEIGHT") if key in entries]
    if "POINTS" not in entries:
        if len(sides) != 2:
            raise MalformedScan("the header has neither POINTS nor WIDTH and HEIGHT")
        return math.prod(sides)
    points = _integer(entries, "POINTS")
    if len(sides) == 2 and math.prod(sides) != points:
        raise MalformedScan(f"WIDTH x HEIGHT is {math.prod(sides):.6g}, POINTS is {points:.6g}")
    return points


def _integer(entries: dict[str, list[str]], key: str) -> int:
    numbers = _integers(entries, key)
    if len(numbers) != 1:
        raise MalformedScan(f"{key} is {short(entries[key])}, wanted one number")
    return numbers[0]


def _integers(entries: dict[str, list[str]], key: str) -> tuple[int, ...]:
    words = entries.get(key, [])
    # 15 digits are a petabyte, and print as a number in every message.
    if not all(word.isascii() and word.isdecimal() and len(word) <= 15 for word in words):
        raise MalformedScan(f"{key} is {short(words)}, wanted whole numbers")
    return tuple(int(word) for word in words)


def _require_bytes(claim: str, claimed: int, points: memoryview) -> None:
    """Reject too few bytes, and too many: then SIZE or COUNT hides part of each point.

    Zeros may follow: older releases of PCL fill the last page with them.
    """
    is_filled = not np.frombuffer(points[claimed:], np.uint8).any()
    given = min(len(points), claimed) if is_filled else len(points)
    message = f"the header claims {claim}, {claimed} bytes; got {given} bytes of points"
    require_amount(given, claimed, message)


def _text_points(points: memoryview, header: _Header, first_line: int) -> Float32Array:
    returns_m = text_columns(points, header.columns, header.width, None, first_line=first_line)
    message = f"the header claims {header.claim}, got {len(returns_m)} lines"
    require_amount(len(returns_m), header.points, message)
    return returns_m


def _binary_points(points: memoryview, header: _Header) -> Float32Array:
    _require_bytes(header.claim, header.size_bytes, points)
    BUDGET.require_returns(header.points)
    return coordinates(np.frombuffer(points, header.record, count=header.points))


def _compressed_points(points: memoryview, header: _Header) -> Float32Array:
    if not header.points:
        return np.empty((0, 3), np.float32)
    if len(points) < 8:
        raise TruncatedScan(f"wanted two sizes of 4 bytes, got {len(points)} bytes")
    packed, unpacked = (int.from_bytes(points[at : at + 4], "little") for at in (0, 4))
    content = points[8:]
    _require_bytes(f"{packed} compressed bytes", packed, content)
    require_amount(
        unpacked,
        header.size_bytes,
        f"the header claims {header.claim}, {header.size_bytes} bytes; they unpack to {unpacked}",
    )
    if unpacked > BUDGET.unpacked_bytes:
        raise ScanTooLarge(f"the points take {unpacked} bytes, at most {BUDGET.unpacked_bytes}")
    if unpacked > packed * _LZF_RATIO:
        raise TruncatedScan(f"{packed} compressed bytes cannot unpack to {unpacked}")
    BUDGET.require_returns(header.points)
    try:
        columns = lzf.decompress(bytes(content[:packed]), unpacked) or b""
    except ValueError as error:
        raise MalformedScan(f"the points do not unpack: {error}") from error
    if len(columns) != unpacked:
        raise MalformedScan(f"the points unpack to {len(columns)} bytes, wanted {unpacked}")
    # Compressed points are stored field by field: all of the first, all of the second.
    returns_m = np.empty((header.points, 3), np.float32)
    for column, axis in enumerate(AXES):
        start = header.offsets[column] * header.points
        values = np.frombuffer(columns, header.record[axis], header.points, start)
        returns_m[:, column] = as_float32(values)
    return returns_m
