"""Many scans in one body: a tar stream of scan files that are named by their index."""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from tempfile import SpooledTemporaryFile

from starlette.requests import ClientDisconnect

from app.drives.tar_stream import TarFeed, TarMember
from app.http.client import require_client
from app.http.errors import BodyTooLarge, MalformedBody, MalformedUpload
from app.http.problems import problem_name
from core.errors import InvalidScan, TensorMapError
from core.scans.scan import Scan
from storage.errors import DriveClosed, ScanConflict, StorageError
from storage.files.files import named_disk_errors
from storage.formats.errors import ScanTooLarge, UnknownFormat
from storage.formats.scans.registry import read_scan, suffix_of
from storage.store import Store

_NAME = re.compile(r"(\d{1,16})\.\w+(\.\w+)?", re.ASCII)
_PLAIN = ".bin"
_LAST_INDEX = 2**53
_GROUP_BYTES, _GROUP_SCANS = 4 * 2**20, 256
_PART_BYTES = 64 * 2**10  # of a file that is yet to end, in memory
_MOST_TOLD = 1000
_MOST_CHARACTERS = 200


@dataclass(frozen=True)
class SetAside:
    """A file of an upload that was not stored.

    Attributes:
        name: As the archive has it.
        problem: The error's stable name.
        detail: What was wanted and what came.
    """

    name: str
    problem: str
    detail: str


@dataclass
class Upload:
    """What became of an upload.

    Attributes:
        stored: Indices that are new.
        present: Indices whose scan was there already, the same.
        set_aside: Files that were not stored; the first thousand.
        set_aside_count: How many there were.
    """

    stored: list[int] = field(default_factory=list)
    present: list[int] = field(default_factory=list)
    set_aside: list[SetAside] = field(default_factory=list)
    set_aside_count: int = 0

    def refuse(self, name: str, error: TensorMapError) -> None:
        """Set a file aside."""
        self.set_aside_count += 1
        if len(self.set_aside) < _MOST_TOLD:
            told = str(error)[:_MOST_CHARACTERS]
            shown = name[:_MOST_CHARACTERS]
            self.set_aside.append(SetAside(shown, problem_name(type(error)), told))


class ScanUpload:
    """Stores the scans of a tar stream as its bytes are given, small ones some at a time.

    A file's name is its scan's index, `000012.pcd`; its format is that of `media_type`, or of its
    suffix. What cannot be used is set aside and the rest goes on. Its methods are called from
    threads, one after another.

    Args:
        store: Where to.
        map_slug: The map.
        drive_slug: The drive.
        media_type: Of the files; `None` if their suffixes tell it.
        min_returns: A scan with fewer is set aside.
        most_bytes: How long a file may be.
        folder: Where what came of a file waits for the rest.
    """

    def __init__(
        self,
        store: Store,
        map_slug: str,
        drive_slug: str,
        *,
        media_type: str | None,
        min_returns: int,
        most_bytes: int,
        folder: Path,
    ) -> None:
        self._media_type, self._min_returns = media_type, min_returns
        self._upload = Upload()
        self._group = _Group(store, map_slug, drive_slug, self._upload)
        place = partial(SpooledTemporaryFile, _PART_BYTES, dir=folder)
        self._feed = TarFeed(most_bytes, place)

    def take(self, pieces: Iterable[bytes]) -> None:
        """Store the scans that end within the next bytes; the last ones may wait for more.

        Raises:
            MalformedUpload: If the stream is no tar; scans that came before are stored.
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive is new, and its name is no slug.
            StorageFull: If no space is left; scans that came before are stored.
            TensorMapError: What `pieces` raises; scans that came before are stored.
            ClientDisconnect: If the client left; scans that came before are stored.
        """
        try:
            with named_disk_errors():  # what came of a long file waits on the disk
                for piece in pieces:
                    if piece:  # no bytes would be the end of the stream
                        self._take(piece)
        except StorageError:
            with suppress(StorageError):  # what came whole may still fit
                self.store()
            raise
        except ClientDisconnect:
            self.store()  # what came need not come again
            raise
        except (BodyTooLarge, MalformedBody) as error:
            self.store()
            raise type(error)(f"{error}; {self._so_far()}") from error

    def store(self) -> None:
        """Store the scans that came whole and wait for others."""
        self._group.store()

    def finish(self) -> Upload:
        """Return what became of the files; what is stored is on disk.

        Raises:
            MalformedUpload: If the stream breaks off, or held no file; scans that came before are
                stored.
            TensorMapError: What `take` raises.
        """
        self._take(b"")
        self.store()
        upload = self._upload
        if not (upload.stored or upload.present or upload.set_aside):
            raise MalformedUpload("the tar stream holds no file; wanted scans named by their index")
        return upload

    def _take(self, piece: bytes) -> None:
        try:
            for member in self._feed.take(piece):
                require_client()
                try:
                    index = _index(member)
                    scan = _scan(member, self._media_type, self._min_returns)
                    self._group.add(member.name, index, scan)
                except (InvalidScan, UnknownFormat) as error:
                    self._upload.refuse(member.name, error)
        except MalformedUpload as error:
            self.store()
            raise MalformedUpload(f"{error}; {self._so_far()}") from error

    def _so_far(self) -> str:
        upload = self._upload
        return (
            f"{len(upload.stored)} scans were stored, {len(upload.present)} were there and"
            f" {upload.set_aside_count} were set aside before"
        )


class _Group:
    """Scans that are stored together: to make a small one durable costs more than to write it."""

    def __init__(self, store: Store, map_slug: str, drive_slug: str, upload: Upload) -> None:
        self._drives = store.drives
        self._target = map_slug, drive_slug
        self._upload = upload
        self._scans: dict[int, tuple[str, Scan]] = {}
        self._again: list[tuple[int, str, Scan]] = []
        self._bytes = 0

    def add(self, name: str, index: int, scan: Scan) -> None:
        """Take a scan; store those that there are if they are enough."""
        if index in self._scans:
            self._again.append((index, name, scan))
        else:
            self._scans[index] = name, scan
        self._bytes += scan.points_m.nbytes
        if self._bytes >= _GROUP_BYTES or len(self._scans) + len(self._again) >= _GROUP_SCANS:
            self.store()

    def store(self) -> None:
        """Store the scans, without those that stand in the way of others."""
        scans, self._scans, self._bytes = self._scans, {}, 0
        again, self._again = self._again, []
        while scans:
            try:
                self._put(scans)
                break
            except (ScanConflict, DriveClosed):
                scans = self._without_refused(scans)
        if not again:
            return
        # At each of these indices a scan is stored now: what came first, or what was there.
        refusals = self._drives.refusals(*self._target, [(index, scan) for index, _, scan in again])
        for (index, name, _), refusal in zip(again, refusals, strict=True):
            if refusal is None:
                self._upload.present.append(index)
            else:
                self._upload.refuse(name, refusal)

    def _without_refused(
        self, scans: Mapping[int, tuple[str, Scan]]
    ) -> dict[int, tuple[str, Scan]]:
        pairs = [(index, scan) for index, (_, scan) in scans.items()]
        refusals = self._drives.refusals(*self._target, pairs)
        left = dict(scans)
        for (index, _), refusal in zip(pairs, refusals, strict=True):
            if refusal is not None:
                self._upload.refuse(left.pop(index)[0], refusal)
        return left

    def _put(self, scans: Mapping[int, tuple[str, Scan]]) -> None:
        pairs = [(index, scan) for index, (_, scan) in scans.items()]
        for result in self._drives.put_scans(*self._target, pairs):
            told = self._upload.stored if result.created else self._upload.present
            told.append(result.record.index)


def _index(member: TarMember) -> int:
    name = PurePosixPath(member.name).name
    found = _NAME.fullmatch(name)
    if found is None or int(found[1]) >= _LAST_INDEX:
        raise UnknownFormat(f"the name {name[:80]!r} is no index with a suffix, as 000012.pcd")
    return int(found[1])


def _scan(member: TarMember, media_type: str | None, min_returns: int) -> Scan:
    if member.content is None:
        raise ScanTooLarge(member.reason)
    suffix = suffix_of(member.name)
    if media_type is None and suffix == _PLAIN:
        raise UnknownFormat(
            "records in .bin may be KITTI's, nuScenes' or NCLT's; say which, as ?format=kitti"
        )
    return read_scan(member.content, media_type=media_type, suffix=suffix, min_returns=min_returns)
