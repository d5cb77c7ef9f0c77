"""ASPRS LAS files and their compressed form LAZ.

laspy reads the points. The header is checked here first, because the library trusts it: it reads
as many records as the header claims, and allocates memory for them.
"""

import struct

from core.arrays import Float32Array
from core.text import count_of
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan
from storage.formats.scans.laz import read_points, unpack
from storage.formats.scans.scan_format import ScanFormat

_SHORTEST_HEADER_BYTES = 227
_VLR_BYTES = 54
_COMPRESSED = 0x80
_SHORTEST_RECORD_BYTES = 20
_MOST_VLRS = 1000


class LasFormat(ScanFormat):
    """LAS 1.0 to 1.4 and LAZ; coordinates only, scale and offset applied."""

    name = "LAS"
    media_type = "application/vnd.tensormap.las"
    suffixes = (".las", ".laz")
    magics = (b"LASF",)

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres.

        Raises:
            MalformedScan: If header or points cannot be parsed or do not agree.
            TruncatedScan: If the header claims more than the body has.
            ScanTooLarge: If the points would take more than allowed.
        """
        points = _checked_points(body)
        if body[104] & _COMPRESSED:
            return unpack(body, points)
        from laspy.errors import LaspyException

        try:
            returns_m = read_points(body, points)
        # What the library raises for a damaged file depends on the damage.
        except (
            LaspyException,
            AttributeError,
            IndexError,
            KeyError,
            OSError,
            OverflowError,
            TypeError,
            ValueError,
            struct.error,
        ) as error:
            raise MalformedScan(f"the points cannot be read: {str(error)[:200]}") from error
        if len(returns_m) != points:
            raise TruncatedScan(f"the header claims {points} points, there are {len(returns_m)}")
        return returns_m


def _checked_points(body: bytes) -> int:
    """Return the number of points, after a check of all sizes against the body's length."""
    if not body.startswith(b"LASF"):
        raise MalformedScan(f"the body begins with {body[:4]!r}, .las with b'LASF'")
    if len(body) < _SHORTEST_HEADER_BYTES:
        raise TruncatedScan(
            f"the body has {count_of(len(body), 'byte')}, a header takes at least"
            f" {_SHORTEST_HEADER_BYTES}"
        )
    version = struct.unpack_from("<BB", body, 24)
    if version not in {(1, minor) for minor in range(5)}:
        raise MalformedScan(f"LAS {version[0]}.{version[1]} is unknown, wanted 1.0 to 1.4")
    header_bytes, first_point, vlrs, kind, record_bytes, points = struct.unpack_from(
        "<HIIBHI", body, 94
    )
    least_bytes = {3: 235, 4: 375}.get(version[1], _SHORTEST_HEADER_BYTES)
    if header_bytes < least_bytes or first_point < header_bytes:
        raise MalformedScan(
            f"a header of {header_bytes} bytes and points from {first_point} on, wanted at"
            f" least {least_bytes}"
        )
    if first_point > len(body):
        raise TruncatedScan(f"the points begin at {first_point}, the body has {len(body)} bytes")
    if version[1] == 4:
        points = struct.unpack_from("<Q", body, 247)[0]
    if vlrs > _MOST_VLRS or vlrs * _VLR_BYTES > first_point - header_bytes:
        raise MalformedScan(f"{vlrs} variable records do not fit before byte {first_point}")
    if record_bytes < _SHORTEST_RECORD_BYTES:
        raise MalformedScan(f"a point takes {record_bytes} bytes, wanted at least 20")
    if points * record_bytes > BUDGET.decoded_bytes:
        claim = f"the header claims {points:.6g} points of {record_bytes} bytes"
        raise ScanTooLarge(f"{claim}, at most {BUDGET.decoded_bytes} bytes")
    if not kind & _COMPRESSED and first_point + points * record_bytes > len(body):
        raise TruncatedScan(
            f"{points} points of {record_bytes} bytes from {first_point} on take more than the"
            f" body's {len(body)} bytes"
        )
    BUDGET.require_returns(points)
    if kind & _COMPRESSED and len(body) > BUDGET.packed_points_bytes:
        raise ScanTooLarge(
            f"the compressed points take {len(body)} bytes, at most {BUDGET.packed_points_bytes}"
        )
    return int(points)
