"""From a complete capture to the scans of its drive; runs in the process of a job."""

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from app.captures.recording import open_recording
from app.drives.scan_group import ScanGroup
from app.http.errors import CaptureTooLarge, CaptureTooSlow
from app.process import limited_files
from app.settings import Settings
from core.errors import Cancelled, EmptyDrive, InvalidScan, TensorMapError
from core.progress import Progress
from core.scans.drive import Drive
from core.scans.scan import Scan
from core.text import count_of
from storage.catalog import SERVICE_ID, Act, CaptureRecord, JobRecord, on_behalf
from storage.errors import DriveNotFound, ScanConflict
from storage.files.drive_chunks import BYTES_PER_RETURN
from storage.files.free_space import OF_UPLOADS
from storage.store import Store

_MOST_NOTES = 20
_SQLITE_FOLDER = "SQLITE_TMPDIR"


@dataclass
class CaptureRead:
    """What the scans of a capture became.

    Attributes:
        scans: How many it has.
        stored: How many of them are new.
        present: How many were stored before, the same.
        skipped: How many cannot be used.
        reasons: Why, of the first of these.
        drive_id: Id of the drive that has them.
    """

    scans: int
    stored: int = 0
    present: int = 0
    skipped: int = 0
    reasons: list[str] = field(default_factory=list)
    drive_id: str | None = None

    def skip(self, index: int, reason: str) -> None:
        """Count a scan that cannot be used, which would have this index in the drive."""
        self.skipped += 1
        if len(self.reasons) < _MOST_NOTES:
            self.reasons.append(f"scan {index} was skipped: {reason}")

    def as_json(self) -> dict[str, int | str | None]:
        """Return the numbers and the drive's id, as plain values."""
        names = ("scans", "stored", "present", "skipped", "drive_id")
        return {name: getattr(self, name) for name in names}

    @property
    def notes(self) -> Sequence[str]:
        """What a client should know of it."""
        more = self.skipped - len(self.reasons)
        return [*self.reasons, *([f"and {more} more were skipped"] if more else [])]


def read_capture(
    store: Store, settings: Settings, job: JobRecord, progress: Progress
) -> CaptureRead:
    """Store the scans of the capture of a job, with their times, and poses where it has them.

    A scan that cannot be used is skipped. Repeated after an interruption, it finds the scans that
    are stored already.

    Args:
        store: The store with the capture.
        settings: The settings, of which `min_returns`, `max_upload_bytes` and `capture_read_s`
            apply.
        job: A job of kind `capture`.
        progress: Reports each part that is put together, and each scan.

    Raises:
        PartsMissing: If parts are damaged or gone; they can be sent again.
        CaptureMismatch: If the capture has another digest than was announced.
        CaptureTooLarge: If its returns take more than `max_upload_bytes`.
        CaptureTooSlow: If it takes longer than `capture_read_s`.
        EmptyDrive: If it has no scan that can be used.
        ScanConflict: If the drive has another scan at an index.
        DriveNotFound: If the drive was deleted when it had some of the scans.
        TensorMapError: What `open_drive` raises; nothing is stored then.
    """
    ends_at_s = time.monotonic() + settings.capture_read_s
    capture = store.captures.of_job(job.parameters["capture"])
    with store.captures.files(capture, progress) as folder, _temporary_files_in(folder.parent):
        progress.start("opening", 0)
        drive = _open(folder, capture, settings.min_returns)
        reader = _Reader(store, settings, capture, job, ends_at_s)
        return reader.read(drive, progress)


def _open(folder: Path, capture: CaptureRecord, min_returns: int) -> Drive:
    """Open the recording; what its library unpacks is in the same folder, and fits on the disk."""
    names = [name for name, _ in capture.files]
    try:
        with limited_files(OF_UPLOADS.left_bytes(folder) // len(names)):
            return open_recording(folder, names, capture.topic, min_returns=min_returns)
    except TensorMapError as error:  # a client need not know where it was
        detail = str(error).replace(f"{folder}/", "").replace(f"{folder.parent}/", "")
        raise type(error)(detail) from error


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Have temporary files of Python, and of SQLite, which sorts messages in some, in a folder."""
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    of_sqlite = os.environ.get(_SQLITE_FOLDER)
    os.environ[_SQLITE_FOLDER] = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before
        if of_sqlite is None:
            del os.environ[_SQLITE_FOLDER]
        else:
            os.environ[_SQLITE_FOLDER] = of_sqlite


class _Reader:
    """Stores the scans of a drive in groups, within limits."""

    def __init__(
        self,
        store: Store,
        settings: Settings,
        capture: CaptureRecord,
        job: JobRecord,
        ends_at_s: float,
    ) -> None:
        self._store, self._capture = store, capture
        detail = f"capture {capture.id} into drive {capture.drive}"
        self._act = Act(SERVICE_ID, "read_capture", f"/v1/jobs/{job.id}", job.map_slug, detail)
        self._ends_at_s, self._most_s = ends_at_s, settings.capture_read_s
        self._most_bytes = settings.max_upload_bytes
        self._group = ScanGroup[tuple[int, Scan]]()
        self._bytes = 0

    def read(self, drive: Drive, progress: Progress) -> CaptureRead:
        """Store all scans, and return what they became."""
        done = CaptureRead(len(drive))
        try:
            self._read(drive, done, progress)
        except (Cancelled, DriveNotFound):
            raise
        except (TensorMapError, MemoryError) as error:
            if not done.stored:
                raise
            # NumPy's own kind of it is made of a shape and a type.
            kind = MemoryError if isinstance(error, MemoryError) else type(error)
            so_far = (
                f"{done.stored} of its {count_of(done.scans, 'scan')} are stored in"
                f" drive {self._capture.drive!r}"
            )
            raise kind("; ".join(filter(None, (str(error), so_far)))) from error
        if not done.stored + done.present:
            raise EmptyDrive(
                f"none of the {count_of(done.scans, 'scan')} of"
                f" {self._capture.files[0][0]} can be used;"
                f" {''.join(done.reasons[:1])}"
            )
        return done

    def _read(self, drive: Drive, done: CaptureRead, progress: Progress) -> None:
        progress.start("storing", len(drive))
        for index in range(len(drive)):
            if time.monotonic() > self._ends_at_s:
                raise CaptureTooSlow(
                    f"the capture was not read within {self._most_s:g} s, after {index} of"
                    f" {count_of(len(drive), 'scan')}"
                )
            index_in_drive = self._capture.first_scan + index
            try:
                scan = drive.scan(index)
            except InvalidScan as error:
                done.skip(index_in_drive, str(error))
            else:
                self._add(index_in_drive, scan, done)
            progress.advance()
        self._store_group(done)

    def _add(self, index: int, scan: Scan, done: CaptureRead) -> None:
        size_bytes = len(scan) * BYTES_PER_RETURN
        self._bytes += size_bytes
        if self._bytes > self._most_bytes:
            raise CaptureTooLarge(
                f"the returns of the capture take more than {self._most_bytes} bytes, at scan"
                f" {index} of the drive"
            )
        if self._group.add((index, scan), scan):
            self._store_group(done)

    def _store_group(self, done: CaptureRead) -> None:
        scans = self._group.take()
        if not scans:
            return
        map_slug = self._store.maps.get_by_id(self._capture.map_id).slug  # it may be renamed
        try:
            with on_behalf(self._act):
                results = self._group.put(self._store.drives, map_slug, self._capture.drive, scans)
        except ScanConflict as error:
            raise ScanConflict(
                f"{error}: upload the capture as another drive, or with another first_scan"
            ) from error
        created = sum(result.created for result in results)
        done.stored += created
        done.present += len(results) - created
        done.drive_id = self._group.drive_id
