"""Many scans in one body: a tar stream of scan files that are named by their index."""

import re
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from tempfile import TemporaryFile
from typing import IO

from anyio import from_thread
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from app.errors import MalformedUpload
from app.problems import problem_name
from app.uploads.tar_stream import TarMember, TarStream
from core.errors import InvalidScan, TensorMapError
from core.scan import Scan
from storage.errors import DriveClosed, ScanConflict
from storage.files import named_disk_errors
from storage.formats.errors import ScanTooLarge, UnknownFormat
from storage.formats.registry import read_scan, suffix_of
from storage.store import Store

__all__ = ["BodyReader", "SetAside", "Upload", "spooled", "store_scans"]

_NAME = re.compile(r"(\d{1,16})\.\w+(\.\w+)?", re.ASCII)
_PLAIN = ".bin"
_LAST_INDEX = 2**53
_GROUP_BYTES, _GROUP_SCANS = 4 * 2**20, 256
_MOST_TOLD = 1000
_MOST_CHARACTERS = 200


class BodyReader:
    """Reads an asynchronous body from the thread of a route."""

    def __init__(self, stream: AsyncIterator[bytes]) -> None:
        self._stream = stream
        self._chunk = b""
        self._at = 0

    def __call__(self, size: int) -> bytes:
        """Return up to so many bytes, none at the end.

        Raises:
            ClientDisconnect: If the connection is cut.
        """
        while self._at >= len(self._chunk):
            self._chunk, self._at = from_thread.run(self._next), 0
            if not self._chunk:
                return b""
        piece = self._chunk[self._at : self._at + size]
        self._at += len(piece)
        return piece

    async def _next(self) -> bytes:
        async for chunk in self._stream:
            if chunk:
                return chunk
        return b""


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


@contextmanager
def spooled(read: BodyReader, folder: str) -> Iterator[IO[bytes]]:
    """Write a body to a file without a name, whole, and give it back from its beginning."""
    with TemporaryFile(dir=folder) as file:
        while chunk := read(2**20):
            with named_disk_errors():
                file.write(chunk)
        with named_disk_errors():
            file.seek(0)
        yield file


def store_scans(
    store: Store,
    map_slug: str,
    drive_slug: str,
    archive: TarStream,
    *,
    media_type: str | None,
    min_returns: int,
) -> Upload:
    """Store the scans of a tar stream as they come, small ones some at a time.

    A file's name is its scan's index, `000012.pcd`; its format is that of `media_type`, or of its
    suffix. What cannot be used is set aside and the rest goes on. When it returns, what is stored
    is on disk.

    Raises:
        MalformedUpload: If the stream is no tar, breaks off, or holds no file; scans that came
            before are stored.
        HTTPException: If the body goes beyond a limit; scans that came before are stored.
        MapNotFound: If there is no such map.
        InvalidSlug: If the drive is new, and its name is no slug.
        StorageFull: If no space is left; scans that came before are stored.
    """
    upload = Upload()
    group = _Group(store, map_slug, drive_slug, upload)
    try:
        for member in archive:
            try:
                group.add(member.name, _index(member), _scan(member, media_type, min_returns))
            except (InvalidScan, UnknownFormat) as error:
                upload.refuse(member.name, error)
    except (ClientDisconnect, HTTPException):  # cut off by the client, or by a limit of ours
        group.store()  # what came need not come again
        raise
    except MalformedUpload as error:
        group.store()
        raise MalformedUpload(
            f"{error}; {len(upload.stored)} scans were stored, {len(upload.present)} were there"
            f" and {upload.set_aside_count} were set aside before"
        ) from error
    group.store()
    if not (upload.stored or upload.present or upload.set_aside):
        raise MalformedUpload("the tar stream holds no file; wanted scans named by their index")
    return upload


class _Group:
    """Scans that are stored together: to make a small one durable costs more than to write it."""

    def __init__(self, store: Store, map_slug: str, drive_slug: str, upload: Upload) -> None:
        self._drives = store.drives
        self._target = map_slug, drive_slug
        self._upload = upload
        self._scans: dict[int, tuple[str, Scan]] = {}
        self._bytes = 0

    def add(self, name: str, index: int, scan: Scan) -> None:
        """Take a scan; store those that there are if they are enough."""
        if index in self._scans:
            self.store()
        self._scans[index] = name, scan
        self._bytes += scan.points_m.nbytes
        if self._bytes >= _GROUP_BYTES or len(self._scans) >= _GROUP_SCANS:
            self.store()

    def store(self) -> None:
        """Store the scans: together, or each by itself if one of them stands in the way."""
        scans, self._scans, self._bytes = self._scans, {}, 0
        try:
            self._put(scans)
        except (ScanConflict, DriveClosed):
            for index, (name, scan) in scans.items():
                try:
                    self._put({index: (name, scan)})
                except (ScanConflict, DriveClosed) as error:
                    self._upload.refuse(name, error)

    def _put(self, scans: Mapping[int, tuple[str, Scan]]) -> None:
        if not scans:
            return
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
