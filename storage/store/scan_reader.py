"""Scans of a drive, read from its chunk files and checked against their digests."""

from pathlib import Path

from core.arrays import Float32Array
from core.scans.scan import Scan
from storage.catalog import Catalog, DriveRecord, ScanRecord
from storage.errors import CorruptFile, ReturnsGone
from storage.files.drive_chunks import ChunkFile, scan_digest


class ScanReader:
    """Reads the scans of a drive, fastest in the order of their chunk files.

    Args:
        catalog: Locates each scan when it is read.
        drive: The drive.
        chunks: The folder of its chunk files.
    """

    def __init__(self, catalog: Catalog, drive: DriveRecord, chunks: Path) -> None:
        self._catalog = catalog
        self._drive = drive
        self._chunks = chunks
        self._open: tuple[str, ChunkFile] | None = None

    def scan(self, index: int) -> Scan:
        """Read one scan with its timestamp and pose.

        Raises:
            ScanNotFound: If the drive has no such scan, or was deleted.
            ReturnsGone: If its returns were dropped after a build.
            CorruptFile: If the stored scan is not the one that was put.
        """
        record = self._record(index)
        try:
            points_m = self._points_m(record)
        except FileNotFoundError as error:
            moved = self._record(index)  # or dropped meanwhile
            if moved.chunk == record.chunk:
                self._catalog.require_writable()  # it may be the whole folder that is gone
                raise CorruptFile(
                    f"the file of scan {index} of drive {self._drive.slug!r} is gone:"
                    f" {record.chunk}; restore it, or send the scan again"
                ) from error
            points_m = self._points_m(moved)  # compacted meanwhile
        digest = scan_digest(points_m)
        if digest != record.digest:
            raise CorruptFile(
                f"scan {index} of drive {self._drive.slug!r} has digest {digest},"
                f" {record.digest} was put"
            )
        return Scan(
            points_m,
            timestamp_s=record.timestamp_s,
            pose=record.pose,
            dropped_returns=record.dropped_returns,
        )

    def _record(self, index: int) -> ScanRecord:
        record = self._catalog.scans.get(self._drive.id, index)
        if not record.has_returns:
            raise ReturnsGone(
                f"the returns of scan {index} of drive {self._drive.slug!r} were dropped after a"
                " build"
            )
        return record

    def _points_m(self, record: ScanRecord) -> Float32Array:
        opened = self._open  # another thread may replace it
        try:
            if opened is None or opened[0] != record.chunk:
                opened = self._open = record.chunk, ChunkFile(self._chunks / record.chunk)
            return opened[1].points_m(record.row)
        except CorruptFile as error:
            raise CorruptFile(
                f"scan {record.index} of drive {self._drive.slug!r}: {error}"
            ) from error
