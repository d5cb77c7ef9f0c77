"""Which scans are places, which are queries, and what each query may be compared with."""

from dataclasses import dataclass, field

import numpy as np

from core.arrays import IntArray
from core.errors import InvalidParameters
from core.evaluation.query_set import hold_out, require_scans
from core.evaluation.split import Interleaved, Split
from core.numbers import require_above, require_at_least
from core.scans.drive import Drive
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH, cut_fixed

RECENT_SCANS = 50


@dataclass(frozen=True, eq=False)
class Paired:
    """Places and queries.

    Attributes:
        places: `(K,)` scans of the drive, rising.
        queries: `(Q,)` scans of the drive that queries it, rising.
        first_excluded: `(Q,)` a query may be compared with places that are scans below this one.
    """

    places: IntArray
    queries: IntArray
    first_excluded: IntArray


@dataclass(frozen=True)
class HeldOut:
    """Some scans of a drive are the queries; the others are the places.

    Attributes:
        split: Which.
        segment_length: The length k, in scans, of the segments over which `split` counts.
    """

    split: Split = field(default_factory=Interleaved)
    segment_length: int = PAPER_SEGMENT_LENGTH

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        """Choose places and queries of the one drive."""
        if query_drive is not None:
            raise InvalidParameters("with a query drive the whole drive is mapped: leave the split")
        require_scans(drive)
        held_out = hold_out(self.split, cut_fixed(len(drive), self.segment_length))
        queries = np.flatnonzero(held_out)
        return Paired(np.flatnonzero(~held_out), queries, np.full(len(queries), len(drive)))

    def __str__(self) -> str:
        return f"held out {self.split}"


@dataclass(frozen=True)
class SecondPass:
    """A drive is mapped whole and queried with another one, in the same world frame.

    Attributes:
        every: Query with every N-th scan; neighbours, 0.1 s apart, are nearly equal.
    """

    every: int = 1

    def __post_init__(self) -> None:
        require_at_least(1, every=self.every)

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        """Choose all places, and queries of the other drive."""
        if query_drive is None:
            raise InvalidParameters("a second pass wants a query drive")
        require_scans(drive, query_drive)
        queries = np.arange(0, len(query_drive), self.every)
        return Paired(np.arange(len(drive)), queries, np.full(len(queries), len(drive)))

    def __str__(self) -> str:
        return "second pass" + (f", every {self.every}" if self.every > 1 else "")


@dataclass(frozen=True)
class LoopClosing:
    """Every scan of a drive is a query among the earlier ones that are not recent.

    Attributes:
        recent_scans: A place is at least this many scans before its query.
        recent_s: Or this many seconds; exactly one of the two is given.
    """

    recent_scans: int | None = RECENT_SCANS
    recent_s: float | None = None

    def __post_init__(self) -> None:
        if (self.recent_scans is None) == (self.recent_s is None):
            raise InvalidParameters("give recent_scans or recent_s, one of them")
        require_at_least(1, recent_scans=self.recent_scans)
        require_above(0, recent_s=self.recent_s)

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        """Choose every scan as a place, and as a query if there is an earlier place."""
        if query_drive is not None:
            raise InvalidParameters("loops are closed within one drive: leave the query drive out")
        require_scans(drive)
        scans = np.arange(len(drive))
        if self.recent_scans is not None:
            first_excluded = np.maximum(scans - self.recent_scans + 1, 0)
        else:
            time_s = drive.timestamp_s
            if not np.isfinite(time_s).all() or (np.diff(time_s) < 0).any():
                raise InvalidParameters(
                    "timestamps are unknown or falling: exclude by scans instead"
                )
            first_excluded = np.searchsorted(time_s, time_s - (self.recent_s or 0.0), side="right")
        queried = first_excluded > 0
        if not queried.any():
            raise InvalidParameters(f"drive {drive.name} is too short for {self}: exclude less")
        return Paired(scans, scans[queried], first_excluded[queried])

    def __str__(self) -> str:
        recent = (
            f"{self.recent_s:g} s" if self.recent_scans is None else f"{self.recent_scans} scans"
        )
        return f"loop closing, with places at least {recent} before"


Pairing = HeldOut | SecondPass | LoopClosing
"""A protocol of comparison; `pair` rejects drives that do not fit it with `InvalidParameters`."""
