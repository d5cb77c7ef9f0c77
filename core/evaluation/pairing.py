"""Which scans are places, which are queries, and what each query may be compared with."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from core.arrays import IntArray
from core.errors import InvalidParameters
from core.evaluation.query_set import hold_out, require_scans
from core.evaluation.split import Interleaved, Split
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


class Pairing(Protocol):
    """A protocol of comparison."""

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        """Choose places and queries.

        Raises:
            InvalidParameters: If there is no query, or the protocol does not fit the drives.
        """


@dataclass(frozen=True)
class HeldOut:
    """Scans of one drive are held out and queried with.

    Attributes:
        split: Which.
        segment_length: Of the segments over which `split` counts; k in scans.
    """

    split: Split = field(default_factory=Interleaved)
    segment_length: int = PAPER_SEGMENT_LENGTH

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        """Choose places and queries of the one drive."""
        if query_drive is not None:
            raise InvalidParameters("with a query drive all of the drive is the map: split none")
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
        every: Query with every N-th scan: its neighbours, 0.1 s apart, say little more.
    """

    every: int = 1

    def __post_init__(self) -> None:
        if self.every < 1:
            raise InvalidParameters(f"every is {self.every}, wanted 1 or more")

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
    """Every scan of a drive is a query as it comes, among the earlier ones that are not recent.

    Attributes:
        recent_scans: How many scans before its query a place is at least.
        recent_s: Or how many seconds; one of the two is given.
    """

    recent_scans: int | None = RECENT_SCANS
    recent_s: float | None = None

    def __post_init__(self) -> None:
        if (self.recent_scans is None) == (self.recent_s is None):
            raise InvalidParameters("give recent_scans or recent_s, one of them")
        if self.recent_scans is not None and self.recent_scans < 1:
            raise InvalidParameters(f"recent_scans is {self.recent_scans}, wanted 1 or more")
        if self.recent_s is not None and not 0 < self.recent_s < math.inf:
            raise InvalidParameters(f"recent_s is {self.recent_s}, wanted seconds above 0")

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        """Choose every scan as a place, and as a query if there is a place before it."""
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
                    "not all scans have a time, or times fall: exclude by scans instead"
                )
            first_excluded = np.searchsorted(time_s, time_s - (self.recent_s or 0.0), side="right")
        asked = first_excluded > 0
        if not asked.any():
            raise InvalidParameters(f"drive {drive.name} is too short for {self}: exclude less")
        return Paired(scans, scans[asked], first_excluded[asked])

    def __str__(self) -> str:
        recent = (
            f"{self.recent_s:g} s" if self.recent_scans is None else f"{self.recent_scans} scans"
        )
        return f"loop closing, with places at least {recent} before"
