"""The x, y and z of points: from records of any layout to float32 metres."""

from typing import Any

import numpy as np

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, TruncatedScan

AXES = ("x", "y", "z")
_KINDS = {
    b"PK\x03\x04": "zip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\xfd7zXZ\0": "xz",
    b"BZh91AY&SY": "bzip2",
    b"\x89HDF\r\n\x1a\n": "HDF5",
    b"\x93NUMPY": "NumPy",
    b"# .PCD": "PCD",
    b"VERSION ": "PCD",
    b"FIELDS ": "PCD",
    b"ply\n": "PLY",
    b"ply\r\n": "PLY",
    b"x,y,z": "CSV",
    b"X,Y,Z": "CSV",
    b"LASF": "LAS",
    b"MATLAB 5.0 MAT-file": "MATLAB",
    b"\xd4\xc3\xb2\xa1": "pcap",
    b"\xa1\xb2\xc3\xd4": "pcap",
    b"\x4d\x3c\xb2\xa1": "pcap",
    b"\xa1\xb2\x3c\x4d": "pcap",
    b"#ROSBAG": "ROS bag",
    b"\x89MCAP0\r\n": "MCAP",
    b"SQLite format 3\0": "SQLite",
}
_TAR, _TAR_AT = b"ustar", 257
_GZIP, _GZIP_FLAGS = b"\x1f\x8b\x08", 0x1F


def as_float32(values: np.ndarray) -> Float32Array:
    """Return numbers as float32; those out of range become infinite, which is no return."""
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32)


def coordinates(records: np.ndarray) -> Float32Array:
    """Return the fields x, y and z of `(n,)` records, `(n, 3)`."""
    return np.stack([as_float32(records[axis]) for axis in AXES], axis=1)


def leading_columns(records: Float32Array) -> Float32Array:
    """Return the first three columns of `(n, 3 or more)` records as an array of their own.

    Column by column: four times faster than copying short rows.
    """
    columns = np.empty((len(records), len(AXES)), np.float32)
    for axis in range(len(AXES)):
        columns[:, axis] = records[:, axis]
    return columns


def record_of(fields: dict[str, tuple[Any, int]], size_bytes: int) -> np.dtype[np.void]:
    """Return a record of `size_bytes` with fields of a kind at an offset; the rest is ignored."""
    return np.dtype(
        {
            "names": list(fields),
            "formats": [dtype for dtype, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": size_bytes,
        }
    )


def require_amount(given: int, claimed: int, message: str) -> None:
    """Reject a body of another length than its header claims.

    Raises:
        TruncatedScan: If less is given than claimed.
        MalformedScan: If more is given.
    """
    if given < claimed:
        raise TruncatedScan(message)
    if given > claimed:
        raise MalformedScan(message)


def _kind_of(body: bytes) -> str | None:
    r"""Return which kind of file the body is by how it begins, `None` if it may be records.

    As float32 none of these beginnings are coordinates that a lidar measures.

    Examples:
        >>> _kind_of(b"PK\x03\x04" + bytes(28)), _kind_of(bytes(32))
        ('zip', None)
    """
    if body[_TAR_AT : _TAR_AT + len(_TAR)] == _TAR:
        return "tar"
    if body.startswith(_GZIP) and len(body) > len(_GZIP) and body[len(_GZIP)] <= _GZIP_FLAGS:
        return "gzip"
    return next((kind for begin, kind in _KINDS.items() if body.startswith(begin)), None)


def require_records(body: bytes, record_bytes: int, layout: str) -> None:
    """Reject a body without a header that is no whole number of records, or too many.

    Args:
        body: The records.
        record_bytes: Length of each.
        layout: The records' layout in words, for the message.

    Raises:
        MalformedScan: If it is an archive, or another file that begins as no record does.
        TruncatedScan: If the last record is incomplete.
        ScanTooLarge: If there are more records than a scan may have returns.
    """
    kind = _kind_of(body)
    if kind is not None:
        raise MalformedScan(f"the body is a file of kind {kind}, wanted {layout}")
    records, left = divmod(len(body), record_bytes)
    if left:
        raise TruncatedScan(
            f"the body has {len(body)} bytes, which is {records} records of {record_bytes} and"
            f" {left} left over; wanted {layout}"
        )
    BUDGET.require_returns(records)
