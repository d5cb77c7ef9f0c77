"""Segments that fit the length of a drive, where nobody chose them."""

import math

from core.errors import InvalidParameters
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH

SEGMENT_M = 100.0
"""Least length of a segment of a drive with poses."""
SEGMENT_SCANS = 100
"""Least number of scans in one of a drive without."""
_SEGMENTS = 5  # L of the paper, sec. 3.2


def fitting_length(scans: int, path_m: float) -> int:
    """Return k for a drive: a fifth of it as in the paper, neither too short nor too long.

    A segment is at least `SEGMENT_M` or, where the path is unknown, `SEGMENT_SCANS` long, and has
    at most the paper's 760 scans: long segments are easier to distinguish.

    Args:
        scans: Number of its scans.
        path_m: Length of its path, NaN where unknown.

    Examples:
        >>> fitting_length(250, 443.0), fitting_length(250, math.nan), fitting_length(4541, 3724.0)
        (57, 100, 760)
    """
    least = SEGMENT_SCANS
    if math.isfinite(path_m):
        least = math.ceil(scans * SEGMENT_M / max(path_m, 1.0))
    return min(PAPER_SEGMENT_LENGTH, max(math.ceil(scans / _SEGMENTS), least))


def require_segments(scans: int, *, segment_length: int | None, segments: int | None) -> None:
    """Reject segments of one scan: they are the scans over again, each with nodes of its own.

    Args:
        scans: Number of scans of the longest drive.
        segment_length: k, at least 2, but of a drive of one scan.
        segments: L instead, at most half of the scans.

    Raises:
        InvalidParameters: If segments of one scan would be most.
    """
    if segments is not None and 2 * segments > max(2, scans):
        raise InvalidParameters(
            f"segments is {segments}, the longest drive has {scans} scans: wanted at most"
            f" {max(1, scans // 2)}, of two scans each"
        )
    if segment_length is not None and segment_length < min(2, scans):
        raise InvalidParameters(
            f"segment_length is {segment_length}, the longest drive has {scans} scans: wanted at"
            " least 2"
        )
