"""Drives that are one file: a capture of a Velodyne's packets, a scan for each revolution."""

import mmap
from pathlib import Path

import numpy as np

from core.arrays import FloatArray, frozen
from core.errors import InvalidScan
from core.scans.pose import UNKNOWN_POSE
from core.scans.scan import Scan
from storage.formats.errors import EmptyBody
from storage.formats.scans.velodyne import Turns


class CapturedDrive:
    """The full revolutions of a capture; packets are in memory, points are computed on demand.

    Attributes:
        name: A short name.
        timestamp_s: `(K,)` start of each revolution, seconds since 1970.
        poses: `(K, 7)`, all unknown.
    """

    def __init__(self, name: str, turns: Turns, *, min_returns: int = 1) -> None:
        self.name = name
        self.timestamp_s = turns.time_s
        self.poses: FloatArray = frozen(np.full((len(turns), 7), UNKNOWN_POSE), np.float64)
        self._turns = turns
        self._min_returns = min_returns

    def __len__(self) -> int:
        return len(self._turns)

    def scan(self, index: int) -> Scan:
        """Return the scan of revolution `index`, 0-based.

        Raises:
            TooFewReturns: If it has fewer returns than `min_returns`.
        """
        return Scan.from_returns(
            self._turns.returns_m(index),
            min_returns=self._min_returns,
            timestamp_s=float(self.timestamp_s[index]),
        )


def open_captured_drive(path: Path, *, min_returns: int = 1) -> CapturedDrive:
    """Open a `.pcap` of an HDL-32E or VLP-16.

    Raises:
        InvalidScan: If it is no such capture; a subclass says why.
    """
    if not path.stat().st_size:
        raise EmptyBody(f"{path.name} is empty, wanted a capture")
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as body:
            turns = Turns(body)
    except InvalidScan as error:
        raise type(error)(f"{path.name}: {error}") from error
    return CapturedDrive(path.stem, turns, min_returns=min_returns)
