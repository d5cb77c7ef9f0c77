"""An upload of a drive: a tar stream of scan files, stored as its bytes arrive."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import PurePosixPath
from tempfile import SpooledTemporaryFile

import numpy as np
from starlette.requests import ClientDisconnect

from app.drives.kitti_files import KittiFiles
from app.drives.scan_group import ScanGroup
from app.drives.schemas import IndexRangeOut, PosesPutOut, UploadOut
from app.drives.tar_scans import member_index, member_scan, member_time_s
from app.drives.tar_stream import TarFeed, TarMember
from app.drives.time_order import TimeOrder
from app.http.client import require_client
from app.http.errors import BodyTooLarge, MalformedBody, MalformedUpload, NothingStored
from app.http.problems import SetAsideOut, problem_type
from app.settings import Settings
from core.errors import InvalidScan, TensorMapError
from core.scans.scan import Scan
from core.text import count_of
from storage.errors import (
    DriveClosed,
    DriveNotFound,
    ScanConflict,
    StorageError,
    StorageFailure,
)
from storage.files.files import named_disk_errors
from storage.formats.errors import UnknownFormat
from storage.store import Store

_PART_BYTES = 64 * 2**10  # of an incomplete file, in memory
_MOST_REPORTED = 1000
_MOST_CHARACTERS = 200  # of a file's name
_MOST_OF_A_REASON = 1000  # the advice is at its end


@dataclass(frozen=True)
class _Waiting:
    index: int
    file: str
    scan: Scan


class ScanUpload:
    """Stores the scans of a tar stream as its bytes arrive, small ones in groups.

    A file's name is its scan's index, `000012.pcd`, or its time, `1679000000.1.pcd`; its format is
    that of its suffix, or of `media_type`. KITTI's times, poses and calibration are used at the
    end. A file that cannot be used is set aside and the next one is read. Its methods are called
    from threads, one after another.

    Args:
        store: The store for the scans.
        settings: The settings; `min_returns` and `max_body_bytes` apply to each file, incomplete
            files are kept in their `data_dir`.
        map_slug: The map.
        drive_slug: The drive.
        media_type: The media type of files whose suffix says none, as `.bin`.
        require_sender: Called before each group of scans, or poses, is stored; raises if the sender
            may no longer do that.
    """

    def __init__(
        self,
        store: Store,
        settings: Settings,
        map_slug: str,
        drive_slug: str,
        media_type: str | None = None,
        *,
        require_sender: Callable[[], None],
    ) -> None:
        self._drives = store.drives
        self._require_sender = require_sender
        self._target = map_slug, drive_slug
        self._media_type, self._min_returns = media_type, settings.min_returns
        self._waiting = ScanGroup[_Waiting]()
        self._stored: list[int] = []
        self._present: list[int] = []
        self._set_aside: list[SetAsideOut] = []
        self._set_aside_count = 0
        self._conflicting: list[str] = []
        place = partial(SpooledTemporaryFile, _PART_BYTES, dir=settings.data_dir)
        self._order: TimeOrder | None = None
        self._kitti = KittiFiles()
        self._last_name = ""
        self._last_file = self._last_scan = ""
        self._of_two_folders: tuple[str, str] | None = None
        self._feed = TarFeed(settings.max_body_bytes, place)

    def order_by_time(self, read: Callable[[], Iterable[bytes]]) -> None:
        """Give files that are named by times their rank in order of time as index.

        Args:
            read: Returns the pieces of the whole tar stream; called several times.

        Raises:
            MalformedUpload: If that cannot be; see `TimeOrder`.
            TensorMapError: What `read` raises.
        """
        try:
            drive = self._drives.open(*self._target)
            stored = drive.scan_index, drive.timestamp_s
            self._waiting.drive_id = drive.id
        except DriveNotFound:
            stored = np.empty(0, np.int64), np.empty(0)
        self._order = TimeOrder(read, *stored)

    def take(self, pieces: Iterable[bytes]) -> None:
        """Store the scans that end within the next bytes; the last ones may wait for more.

        Raises:
            MalformedUpload: If the stream is no tar; earlier scans are stored.
            KeyRefused: What `require_sender` raises; earlier groups are stored.
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive is new, and its name is no slug.
            DriveNotFound: If the drive was deleted meanwhile, with the earlier scans.
            StorageFull: If no space is left; earlier scans are stored.
            TensorMapError: What `pieces` raises; earlier scans are stored.
            ClientDisconnect: If the client left; earlier scans are stored.
        """
        try:
            with self._stored_count(), named_disk_errors():  # incomplete long files are on disk
                for piece in pieces:
                    if piece:  # no bytes would be the end of the stream
                        self._take(piece)
        except ClientDisconnect:
            self.store()  # so that the client need not send these again
            raise
        except (BodyTooLarge, MalformedBody) as error:
            self.store()
            raise type(error)(f"{error}; {self._so_far()}") from error

    def store(self) -> None:
        """Store the complete scans that wait for others."""
        self._require_sender()
        waiting = self._waiting.take()
        first: dict[int, _Waiting] = {}
        repeated = [item for item in waiting if first.setdefault(item.index, item) is not item]
        scans: Sequence[_Waiting] = tuple(first.values())
        while scans:
            try:
                indexed = [(item.index, item.scan) for item in scans]
                results = self._waiting.put(self._drives, *self._target, indexed)
            except (ScanConflict, DriveClosed):
                scans = self._without_refused(scans)
                continue
            for result in results:
                indices = self._stored if result.created else self._present
                indices.append(result.record.index)
            break
        # The scans at these indices are stored by now: repeated files must be the same.
        if repeated:
            self._present += [item.index for item in self._without_refused(repeated)]

    def finish(self) -> UploadOut:
        """Return the result for each file; stored scans are on disk.

        Raises:
            MalformedUpload: If the stream is incomplete or has no file; earlier scans are stored.
            NothingStored: If no file can be used.
            TensorMapError: What `take` raises.
        """
        with self._stored_count():
            self._take(b"")
            self.store()
            self._require_sender()
            poses = self._kitti.put(
                self._drives,
                *self._target,
                self._refuse,
                self._conflicting,
                self._waiting.drive_id,
            )
        if not (self._stored or self._present or self._kitti.used):
            if not self._set_aside:
                raise MalformedUpload(
                    "the tar stream has no file, wanted scans named by their index"
                )
            first, files = self._set_aside[0], self._set_aside_count
            raise NothingStored(
                f"0 of {count_of(files, 'file')} can be used; {first.file}: {first.detail}",
                [item.model_dump() for item in self._set_aside],
            )
        return UploadOut(
            scans_stored=len(self._stored),
            scans_present=len(self._present),
            files_set_aside=self._set_aside_count,
            stored=IndexRangeOut.all_of(self._stored),
            present=IndexRangeOut.all_of(self._present),
            set_aside=self._set_aside,
            poses=None if poses is None else PosesPutOut.of(poses),
            notes=self._notes(),
        )

    def with_stored_count(self, error: TensorMapError) -> TensorMapError:
        """Return a failure of the storage, which also says what is stored."""
        return type(error)(f"{error}; {self._so_far()}: send the archive again")

    @contextmanager
    def _stored_count(self) -> Iterator[None]:
        try:
            yield
        except StorageFailure as error:
            with suppress(StorageError):  # complete scans may still fit
                self.store()
            raise self.with_stored_count(error) from error

    def _take(self, piece: bytes) -> None:
        try:
            for member in self._feed.take(piece):
                require_client()
                self._last_file = member.name
                if isinstance(member.content, InvalidScan):
                    self._refuse(member.name, member.content)
                    continue
                if self._kitti.take(member):
                    continue
                try:
                    index, time_s = self._place(member)
                    scan = member_scan(member, self._media_type, self._min_returns, time_s)
                except (InvalidScan, UnknownFormat) as error:
                    self._refuse(member.name, error)
                else:
                    self._note_folder(member.name)
                    self._add(_Waiting(index, member.name, scan))
        except MalformedUpload as error:
            self.store()
            raise MalformedUpload(f"{error}; {self._so_far()}") from error

    def _note_folder(self, name: str) -> None:
        before, self._last_scan = self._last_scan, name
        is_elsewhere = PurePosixPath(before).parent != PurePosixPath(name).parent
        if before and is_elsewhere and self._of_two_folders is None:
            self._of_two_folders = before, name

    def _notes(self) -> list[str]:
        notes = []
        if not self._feed.has_end:
            notes.append(
                f"the archive ends after {_short(self._last_file)} without the zeros that end one:"
                " check the number of scans, as it may be cut off between two files"
            )
        if self._of_two_folders is not None:
            one, other = map(_short, self._of_two_folders)
            notes.append(
                f"{one} and {other} are in different folders, and are scans of one drive as are the"
                " others: if they are of several drives, upload each as a drive of its own"
            )
        return notes

    def _place(self, member: TarMember) -> tuple[int, float]:
        """Return the index and time of a file, NaN if its name is no time.

        Raises:
            MalformedUpload: If it is named by a time in a stream that began with indices.
            UnknownFormat: If the name is no index, and no time.
        """
        time_s = member_time_s(member)
        if time_s is None:
            self._last_name = member.name
            return member_index(member), math.nan
        if self._order is None:
            raise MalformedUpload(
                f"{member.name[:80]!r} is named by a time and comes after"
                f" {self._last_name[:80]!r}, which is not: wanted names that are all times or all"
                " indices"
            )
        return self._order.index(time_s), time_s

    def _add(self, item: _Waiting) -> None:
        if self._waiting.add(item, item.scan):
            self.store()

    def _without_refused(self, scans: Sequence[_Waiting]) -> Sequence[_Waiting]:
        """Return the scans that the drive accepts; set the others aside."""
        refusals = self._drives.refusals(*self._target, [(s.index, s.scan) for s in scans])
        for item, refusal in zip(scans, refusals, strict=True):
            if refusal is not None:
                self._refuse(item.file, refusal)
            if isinstance(refusal, ScanConflict):
                self._conflicting.append(item.file[:_MOST_CHARACTERS])
        return [item for item, why in zip(scans, refusals, strict=True) if why is None]

    def _refuse(self, file: str, error: TensorMapError) -> None:
        self._set_aside_count += 1
        if len(self._set_aside) < _MOST_REPORTED:
            self._set_aside.append(
                SetAsideOut(
                    file=file[:_MOST_CHARACTERS],
                    type=problem_type(type(error).__name__),
                    detail=str(error)[:_MOST_OF_A_REASON],
                )
            )

    def _so_far(self) -> str:
        return (
            f"{count_of(len(self._stored), 'scan')} stored before, {len(self._present)} there"
            f" already, {self._set_aside_count} skipped"
        )


def _short(name: str) -> str:
    return repr(name[:80])
