"""The indices of scans whose files are named by times: their ranks in order of time."""

from array import array
from collections.abc import Callable, Iterable
from pathlib import PurePosixPath

import numpy as np

from app.drives.tar_scans import is_index, member_time_s
from app.drives.tar_stream import listed
from app.http.errors import MalformedUpload
from core.arrays import FloatArray, IntArray
from core.scans.trajectory import SCAN_INDEX_LIMIT
from storage.formats.scans.file_names import Fractions
from storage.store.put_scans import MOST_SCANS


class TimeOrder:
    """The index of each file of an upload by its time.

    Stored scans keep their indices. A scan between two of them gets one between theirs, a later one
    continues; so an upload that was interrupted can be sent again, and another one appended.

    Args:
        read: Returns the pieces of the whole tar stream; called once, or twice to name files.
        stored_scans: `(K,)` indices of the drive's scans, ascending.
        stored_s: `(K,)` their times, NaN where unknown.

    Raises:
        MalformedUpload: If some names are times and others indices, two are the same time, their
            fractions may be no decimals, or a scan has no index left between those of stored ones,
            or behind them.
    """

    def __init__(
        self,
        read: Callable[[], Iterable[bytes]],
        stored_scans: IntArray,
        stored_s: FloatArray,
    ) -> None:
        self._read = read
        times, fractions = array("d"), Fractions()
        by_index = ""
        for member in listed(read()):
            time_s = member_time_s(member)
            if time_s is not None:
                times.append(time_s)
                fractions.take(PurePosixPath(member.name).name)
            elif not by_index and is_index(member.name):
                by_index = member.name
            if by_index and times:
                raise MalformedUpload(
                    f"{self._name_of(times[0])} is named by a time, {by_index} by an index: wanted"
                    " one or the other; nothing was stored"
                )
        if fractions.flaw:
            raise MalformedUpload(f"{fractions.flaw}; nothing was stored")
        self._times_s = np.sort(np.array(times))
        same = np.flatnonzero(np.diff(self._times_s) == 0.0)
        if len(same):
            time_s = float(self._times_s[same[0]])
            raise MalformedUpload(
                f"{self._name_of(time_s)} and {self._name_of(time_s, 1)} are the same time; nothing"
                " was stored"
            )
        self._indices = self._among(stored_scans, stored_s)

    def index(self, time_s: float) -> int:
        """Return the index of the scan of this time, one of the stream's."""
        return int(self._indices[np.searchsorted(self._times_s, time_s)])

    def _among(self, stored_scans: IntArray, stored_s: FloatArray) -> IntArray:
        """Return the index of each time, given those of stored scans."""
        _require_order(stored_scans, stored_s)
        after = np.searchsorted(stored_s, self._times_s, side="right")
        before = np.concatenate([[-1], stored_scans])[after]
        is_stored = np.concatenate([[np.nan], stored_s])[after] == self._times_s
        # Its rank among the new ones between the same two stored scans.
        first = np.searchsorted(after, after)
        new = np.cumsum(~is_stored)
        rank = new - np.concatenate([[0], new])[first]
        indices = before + np.where(is_stored, 0, rank)
        following = np.concatenate([stored_scans, [SCAN_INDEX_LIMIT]])[after]
        too_large = np.flatnonzero(~is_stored & (indices >= MOST_SCANS))
        if len(too_large):
            raise MalformedUpload(
                f"{self._name_of(float(self._times_s[too_large[0]]))} would be scan"
                f" {indices[too_large[0]]} of the drive, wanted less than {MOST_SCANS}: upload it"
                " as another drive; nothing was stored"
            )
        beyond = np.flatnonzero(indices >= following)
        if len(beyond):
            time_s, scan = float(self._times_s[beyond[0]]), int(following[beyond[0]])
            raise MalformedUpload(
                f"{self._name_of(time_s)} is before scan {scan} of the drive, and no index is left"
                " before that: upload a drive in order of time, or whole; nothing was stored"
            )
        return np.asarray(indices, dtype=np.int64)

    def _name_of(self, time_s: float, number: int = 0) -> str:
        """Return the name of the file of a time; of several the one of that number."""
        named = (member.name for member in listed(self._read()) if member_time_s(member) == time_s)
        return next(name for at, name in enumerate(named) if at == number)[:200]


def _require_order(stored_scans: IntArray, stored_s: FloatArray) -> None:
    """Raise `MalformedUpload` unless the drive's scans have times that rise."""
    untimed, falls = np.isnan(stored_s), np.flatnonzero(~(np.diff(stored_s) > 0.0))
    if untimed.any():
        flaw = f"scan {stored_scans[untimed][0]} of the drive has no time"
        if (others := np.count_nonzero(untimed) - 1) > 0:
            flaw += f", and {others} more have none"
    elif len(falls):
        at = falls[0]
        flaw = (
            f"scan {stored_scans[at + 1]} of the drive, at {stored_s[at + 1]:.15g} s, is not after"
            f" scan {stored_scans[at]} at {stored_s[at]:.15g} s"
        )
    else:
        return
    raise MalformedUpload(
        f"{flaw}, wanted times that rise, to place files that are named by times: set times with"
        " PUT .../poses, or upload the files as another drive; nothing was stored"
    )
