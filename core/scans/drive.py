"""A drive: an ordered recording of scans."""

from collections.abc import Iterable, Iterator
from typing import Protocol, runtime_checkable

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import InvalidParameters
from core.scans.pose import pose_rows
from core.scans.scan import Scan


class Drive(Protocol):
    """An ordered recording of scans; the interface of every reader, store and simulator.

    Timestamps and poses are available without reading a scan, because splits and cuts need them
    first.
    """

    @property
    def name(self) -> str:
        """A short name, for tables and provenance."""

    @property
    def timestamp_s(self) -> FloatArray:
        """`(K,)` seconds, NaN where unknown."""

    @property
    def poses(self) -> FloatArray:
        """`(K, 7)` pose rows, sensor to world, NaN where unknown."""

    def __len__(self) -> int:
        """Return how many scans there are."""

    def scan(self, index: int) -> Scan:
        """Read scan `index`, 0-based.

        Raises:
            InvalidScan: If the recorded scan cannot be used.
        """


@runtime_checkable
class IndexedDrive(Drive, Protocol):
    """A drive whose scans are numbered, with gaps where scans are missing."""

    @property
    def scan_index(self) -> IntArray:
        """`(K,)` the number of each scan, rising."""


def scan_index_of(drive: Drive) -> IntArray:
    """Return the number of each scan of a drive, `(K,)`: its own, or counted from 0."""
    index = drive.scan_index if isinstance(drive, IndexedDrive) else np.arange(len(drive))
    return frozen(index, np.int64)


@runtime_checkable
class NamedDrive(Drive, Protocol):
    """A drive of files: its scans count from 0, whatever numbers are the names of the files."""

    @property
    def named_index(self) -> IntArray | None:
        """`(K,)` the number that each file is named by, rising; `None` if the names are none."""


def recorded_index_of(drive: Drive) -> IntArray:
    """Return the number by which each scan of a drive was recorded, `(K,)`, to see gaps in it.

    That by which its file is named, or else as `scan_index_of`.
    """
    named = drive.named_index if isinstance(drive, NamedDrive) else None
    return scan_index_of(drive) if named is None else frozen(named, np.int64)


class MemoryDrive:
    """A drive in memory.

    Args:
        name: A short name.
        scans: Its scans, in their order.

    Raises:
        InvalidParameters: If one of them is no `Scan`.
    """

    def __init__(self, name: str, scans: Iterable[Scan]) -> None:
        self.name = name
        self._scans = tuple(scans)
        for index, one in enumerate(self._scans):
            if not isinstance(one, Scan):
                raise InvalidParameters(
                    f"scan {index} of drive {name} is of type {type(one).__name__}, wanted Scan:"
                    " Scan.from_returns makes one of (n, 3) metres"
                )
        self.timestamp_s: FloatArray = frozen([s.timestamp_s for s in self._scans], np.float64)
        self.poses: FloatArray = frozen(pose_rows([s.pose for s in self._scans]), np.float64)

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[Scan]:
        return iter(self._scans)

    def scan(self, index: int) -> Scan:
        """Return scan `index`.

        Raises:
            IndexError: If there is no such scan.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"there is no scan {index} in a drive of {len(self)}")
        return self._scans[index]
