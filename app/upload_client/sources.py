"""What an upload sends for each scan of a recorded drive."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from core.scans.drive import Drive
from core.scans.pose import Pose
from core.scans.scan import Scan
from storage.formats.drives.file_drive import FileDrive
from storage.formats.drives.ford_drive import FordDrive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import UnknownFormat
from storage.formats.scans.ford import FordFormat
from storage.formats.scans.npy import NpyFormat
from storage.formats.scans.registry import media_type_of, read_scan, scan_file_body


@dataclass(frozen=True, eq=False)
class ScanBody:
    """One scan as it is sent.

    Attributes:
        index: In the drive.
        body: The bytes.
        media_type: Of the body.
        timestamp_s: NaN where unknown.
        pose: `None` where unknown.
    """

    index: int
    body: bytes
    media_type: str
    timestamp_s: float
    pose: Pose | None

    def returns(self) -> Scan:
        """Return the scan as the service reads it.

        Raises:
            InvalidScan: If it cannot be read; a subclass says why.
        """
        return read_scan(self.body, media_type=self.media_type, min_returns=0)


class Source(Protocol):
    """A drive to upload; scans are numbered from 0 in their order."""

    @property
    def name(self) -> str:
        """A short name."""

    def __len__(self) -> int:
        """Return the number of scans."""

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan as it is sent; sequential access is the fastest.

        Raises:
            InvalidScan: If it cannot be used; a subclass says why.
            UnknownFormat: If no reader claims its file.
            OSError: If its file cannot be read.
        """


class FilesSource:
    """A drive of scan files, which are sent unparsed; satisfies `Source`."""

    def __init__(self, drive: FileDrive, media_type: str | None) -> None:
        self.name = drive.name
        self._drive, self._media_type = drive, media_type or drive.media_type

    def __len__(self) -> int:
        return len(self._drive)

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan as it is sent."""
        drive = self._drive
        body, media_type = scan_file_body(drive.files[index], self._media_type)
        time_s, pose = float(drive.timestamp_s[index]), Pose.from_row(drive.poses[index])
        return ScanBody(index, body, media_type, time_s, pose)


class FordSource:
    """A drive of `Scan*.mat`, sent unparsed with the pose in each; satisfies `Source`."""

    def __init__(self, drive: FordDrive) -> None:
        self.name = drive.name
        self._drive = drive

    def __len__(self) -> int:
        return len(self._drive)

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan as it is sent."""
        scan = self._drive.scan(index)
        body = self._drive.files[index].read_bytes()
        return ScanBody(index, body, FordFormat().media_type, scan.timestamp_s, scan.pose)


class ParsedSource:
    """A capture or bag, whose scans are sent as NumPy arrays; satisfies `Source`."""

    def __init__(self, drive: Drive) -> None:
        self.name = drive.name
        self._drive = drive

    def __len__(self) -> int:
        return len(self._drive)

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan as it is sent."""
        scan = self._drive.scan(index)
        file = io.BytesIO()
        np.save(file, scan.points_m, allow_pickle=False)
        return ScanBody(index, file.getvalue(), NpyFormat().media_type, scan.timestamp_s, scan.pose)


def open_source(path: Path, format_name: str | None = None) -> Source:
    """Open a recorded drive to upload; its scans are read one by one.

    Args:
        path: As of `open_drive`.
        format_name: Of its scan files, if not that of their suffix or layout.

    Raises:
        TensorMapError: What `open_drive` raises.
        UnknownFormat: If there is no such format, or the drive has no scan files.
    """
    media_type = None if format_name is None else media_type_of(format_name)
    drive = open_drive(path)
    if isinstance(drive, FileDrive):
        return FilesSource(drive, media_type)
    if media_type is not None:
        raise UnknownFormat(f"{path} has no scan files of a format to choose: leave --format out")
    return FordSource(drive) if isinstance(drive, FordDrive) else ParsedSource(drive)
