"""The x, y and z of points: from records of any layout to float32 metres."""

from typing import Any

import numpy as np

from core.arrays import Float32Array
from core.text import count_of
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, TruncatedScan
from storage.formats.file_kind import FORM, kind_of

AXES = ("x", "y", "z")


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


def require_records(body: bytes, record_bytes: int, layout: str) -> None:
    """Reject a body without a header that is no whole number of records, or too many.

    Args:
        body: The records.
        record_bytes: Length of each.
        layout: The records' layout in words, for the message.

    Raises:
        MalformedScan: If it is an archive, a form, or another file that begins as no record does.
        TruncatedScan: If the last record is incomplete.
        ScanTooLarge: If there are more records than a scan may have returns.
    """
    kind = kind_of(body)
    if kind is not None:
        mend = ""
        if kind == "gzip":
            mend = ": decompress it first, or of a request by 'Content-Encoding: gzip'"
        elif kind == FORM:
            mend = ": send the file alone, as curl --data-binary or -T does, and -F does not"
        raise MalformedScan(f"the body is a file of kind {kind}, wanted {layout}{mend}")
    records, left = divmod(len(body), record_bytes)
    if left:
        raise TruncatedScan(
            f"the body has {count_of(len(body), 'byte')}, which is"
            f" {count_of(records, 'record')} of {record_bytes} and {left} left over;"
            f" wanted {layout}"
        )
    BUDGET.require_returns(records)
