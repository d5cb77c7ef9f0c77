"""What `tensormap upload` sends of a recorded drive, whatever its layout."""

from abc import ABC, abstractmethod
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from tensormap_client import CaptureFiles, ScanBody, Source, UnusableScan
from tensormap_client.sources import lost_numbers

from core.arrays import Float32Array
from core.errors import InvalidScan
from core.scans.pose import Pose
from storage.formats.drives.file_drive import FileDrive
from storage.formats.drives.ford_drive import FordDrive
from storage.formats.drives.layouts import open_drive
from storage.formats.drives.ros_drive import is_ros_bag, require_topic
from storage.formats.errors import UnknownFormat
from storage.formats.scans.ford import FordFormat
from storage.formats.scans.registry import media_type_of, read_scan, scan_file_body

D = TypeVar("D", FileDrive, FordDrive)


class DriveSource(ABC, Generic[D]):
    """A drive of files, each a scan, which are sent unparsed; satisfies `Source`.

    Args:
        drive: The drive as it was recorded.
    """

    beside: tuple[Path, ...] = ()  # poses and times are sent with each scan

    def __init__(self, drive: D) -> None:
        self.name = drive.name
        self._drive: D = drive

    def __len__(self) -> int:
        return len(self._drive)

    def file_name(self, index: int) -> str:
        """Return the name of a scan's file."""
        return self._drive.files[index].name

    def scan_body(self, index: int) -> ScanBody:
        """Return a scan as it is sent."""
        try:
            body, media_type, time_s, pose = self._sent(index)
        except (InvalidScan, UnknownFormat) as error:
            raise UnusableScan(str(error)) from error
        return ScanBody(
            index,
            body,
            media_type,
            time_s if np.isfinite(time_s) else None,
            None if pose is None else pose.as_tuple(),
            partial(_returns_m, body, media_type),
        )

    @abstractmethod
    def _sent(self, index: int) -> tuple[bytes, str, float, Pose | None]:
        """Return the bytes of a scan, their media type, its time and its pose."""


class FilesSource(DriveSource[FileDrive]):
    """A drive of which times and poses are known beforehand."""

    def __init__(self, drive: FileDrive, media_type: str | None) -> None:
        super().__init__(drive)
        self._media_type = media_type or drive.media_type

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what the upload loses: numbers of missing files, if the scans have no times."""
        if np.isfinite(self._drive.timestamp_s).any():
            return ()
        return lost_numbers([file.name for file in self._drive.files])

    def _sent(self, index: int) -> tuple[bytes, str, float, Pose | None]:
        drive = self._drive
        body, media_type = scan_file_body(drive.files[index], self._media_type)
        time_s, pose = float(drive.timestamp_s[index]), Pose.from_row(drive.poses[index])
        return body, media_type, time_s, pose


class FordSource(DriveSource[FordDrive]):
    """A drive of `Scan*.mat`, sent unparsed with the pose in each."""

    def _sent(self, index: int) -> tuple[bytes, str, float, Pose | None]:
        scan = self._drive.scan(index)
        body = self._drive.files[index].read_bytes()
        return body, FordFormat().media_type, scan.timestamp_s, scan.pose


def open_source(path: Path, format_name: str | None = None) -> Source | CaptureFiles:
    """Open a recorded drive to upload: its scans are read one by one, of a bag only the topics.

    Args:
        path: A path as for `open_drive`.
        format_name: The format of its scan files, if not that of their suffix or layout.

    Raises:
        TensorMapError: What `open_drive` raises.
        UnknownFormat: If there is no such format, or the drive has no scan files.
        MalformedDrive: If a bag has several topics and none is named, or not the named one.
    """
    media_type = media_type_of(format_name)
    found = CaptureFiles.of(path) or open_drive(path)
    if isinstance(found, FileDrive):
        return FilesSource(found, media_type)
    if media_type is None:
        if isinstance(found, CaptureFiles):
            bag = found.files[0].parent if len(found.files) > 1 else found.files[0]
            if is_ros_bag(bag):
                require_topic(bag, found.topic)
            return found
        if isinstance(found, FordDrive):
            return FordSource(found)
    raise UnknownFormat(f"{path} has no scan files of a format to choose: leave --format out")


def _returns_m(body: bytes, media_type: str) -> Float32Array:
    """Return the returns that the service reads of a body."""
    try:
        return read_scan(body, media_type=media_type, min_returns=0).points_m
    except InvalidScan as error:
        raise UnusableScan(str(error)) from error
