"""Results of a demonstration."""

from dataclasses import dataclass

from core.encodings.compression import Compression

MAX_SCANS = 300
RECALL_M = 3.0


@dataclass(frozen=True)
class Fixes:
    """The localizations of all held-out scans by one kind of request.

    Attributes:
        request: The content of a request.
        queries: Number of scans.
        segment_accuracy: Share on the right segment.
        recall_at_1: Share whose map scan was recorded within 3 m, `None` without poses.
        position_error_m: Median error of the estimated position, `None` without poses.
        bytes_per_fix: Mean length of a request's body.
        ms_per_fix: Mean time from scan to answer, including the signature and HTTP.
    """

    request: str
    queries: int
    segment_accuracy: float
    recall_at_1: float | None
    position_error_m: float | None
    bytes_per_fix: float
    ms_per_fix: float


@dataclass(frozen=True)
class Outcome:
    """All results."""

    fixes: tuple[Fixes, ...]
    compression: Compression
    segments: int
    mapped_scans: int
    posted_bytes: int
