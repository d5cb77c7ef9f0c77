"""Captures in parts: a file for each part, until the capture is read."""

import hashlib
import logging
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from core.progress import Progress
from storage.catalog import CaptureRecord, CaptureSummary, Catalog, NewCapture
from storage.catalog.captures import require_open, require_same_part
from storage.errors import (
    CaptureMismatch,
    DriveClosed,
    DriveNotFound,
    PartDoesNotFit,
    PartsMissing,
)
from storage.files.claims import claimed, remove_abandoned
from storage.files.files import (
    discard,
    discarded_on_rollback,
    make_folder,
    named_disk_errors,
    publish,
)
from storage.files.free_space import OF_UPLOADS
from storage.index_ranges import index_ranges, ranges_text
from storage.names import new_id
from storage.store.layout import Layout

_log = logging.getLogger("tensormap.storage")


class Captures:
    """The captures of each map, newest first; methods that only read rows are the catalog's."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self.get = catalog.captures.get
        self.list = catalog.captures.list
        self.of_job = catalog.captures.of_job
        self.complete = catalog.captures.complete

    def create(
        self, map_slug: str, new: NewCapture, most_bytes: int | None = None
    ) -> tuple[CaptureRecord, bool]:
        """Begin a capture; see the catalog's.

        Raises:
            MapNotFound: If there is no such map.
            InvalidSlug: If the drive's name is not a valid slug.
            DriveClosed: If it is new and the drive is closed.
            TooManyCaptures: If the key's limit of bytes of captures is reached.
            StorageFull: If it is new and would not fit on the disk: its parts, and its files made
                of them.
        """
        if not self._catalog.captures.has_same(map_slug, new):
            with suppress(DriveNotFound):
                if self._catalog.drives.find(map_slug, new.drive).closed:
                    raise DriveClosed(f"drive {new.drive!r} is closed and takes no capture")
            self._require_space(2 * new.size_bytes, "the capture, in parts and put together,")
        return self._catalog.captures.create(map_slug, new, most_bytes)

    def put_part(
        self, map_slug: str, drive: str, capture_id: str, number: int, content: bytes
    ) -> tuple[CaptureRecord, bool]:
        """Store a part; return its capture, and whether the part is new.

        When it returns, the part's file is fsynced and its row committed. The same bytes again
        change nothing, unless the file was lost.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
            CaptureQueued: If it takes no more parts.
            PartDoesNotFit: If the capture has no part of this number, or it has another size.
            PartConflict: If other bytes are stored as this part.
            StorageFull: If no space is left; nothing is changed.
        """
        captures = self._catalog.captures
        capture, stored = captures.part(map_slug, drive, capture_id, number)
        require_open(capture)
        _require_fit(capture, number, len(content))
        digest = hashlib.sha256(content).hexdigest()
        if stored is not None:
            require_same_part(capture.id, number, stored[0], digest)
            if _size(self._folder(capture) / stored[1]) == len(content):
                return captures.get(map_slug, drive, capture_id), False
            captures.forget_parts([(capture.id, number, stored[1])])
        self._require_space(len(content), f"part {number}")
        path = self._folder(capture) / f"{number}.{new_id()[:8]}.bin"
        try:
            make_folder(path.parent)
            with discarded_on_rollback(path):
                with publish(path) as part:
                    part.write_bytes(content)
                put, file_name = captures.add_part(
                    map_slug, drive, capture_id, number, digest, path.name
                )
        except FileNotFoundError:  # the capture was deleted or read, and its folder removed
            require_open(captures.get(map_slug, drive, capture_id))
            self._catalog.require_writable()  # it may be the whole folder that is gone
            raise
        if file_name != path.name:  # another request stored it at the same time
            discard(path)
        return put, file_name == path.name

    def _require_space(self, size_bytes: int, what: str) -> None:
        self._catalog.require_writable()  # it may be the whole folder that is gone
        OF_UPLOADS.require(self._layout.maps, size_bytes, what)

    @contextmanager
    def files(self, capture: CaptureRecord, progress: Progress) -> Iterator[Path]:
        """Yield a folder with the files of a complete capture; it is removed after the block.

        Args:
            capture: The capture.
            progress: Reports every part.

        Raises:
            PartsMissing: If parts are missing or not what was received; those can be sent again.
            CaptureMismatch: If the files have another digest than the client gave.
            StorageFull: If no space is left.
        """
        folder = make_folder(self._folder(capture))
        self.remove_abandoned(capture.map_id, capture.id)
        OF_UPLOADS.require(folder, capture.size_bytes, "the capture, put together,")

        def make() -> Path:
            scratch = folder / f".{new_id()}.part"
            with named_disk_errors():
                scratch.mkdir(0o700)
            return scratch

        with claimed(make) as scratch:
            try:
                files = scratch / "capture"  # the name of a bag of several files in errors
                self._put_together(capture, files, progress)
                yield files
            finally:
                shutil.rmtree(scratch, ignore_errors=True)

    def remove_abandoned(self, map_id: str, capture_id: str) -> None:
        """Remove what a killed process has put together of a capture's parts."""
        for left in self._layout.capture(map_id, capture_id).glob(".*.part"):
            if left.is_dir():  # else a part that is written
                remove_abandoned(left)

    def delete(self, map_slug: str, drive: str, capture_id: str) -> None:
        """Remove a capture: its rows at once, then its files; a job that reads it is cancelled.

        Raises:
            MapNotFound: If there is no such map.
            CaptureNotFound: If the drive has no such capture.
        """
        capture = self._catalog.captures.delete(map_slug, drive, capture_id)
        shutil.rmtree(self._folder(capture), ignore_errors=True)

    def clear(self, before: datetime | None) -> int:
        """Remove parts of captures that were read, and captures that expired: some of them.

        Args:
            before: Captures expire that were touched last, and whose job ended, before this; none
                does with `None`.

        Returns:
            How many captures; 0 if nothing is left to remove.
        """
        cleared = self._catalog.captures.clear(before)
        for map_id, capture_id in cleared:
            shutil.rmtree(self._layout.capture(map_id, capture_id), ignore_errors=True)
        return len(cleared)

    def forget_lost(self) -> int:
        """Forget parts whose files are gone, as after a restore; return how many.

        They can be sent again.
        """
        lost = [
            (capture_id, number, name)
            for map_id, captures in self._catalog.captures.named_files().items()
            for capture_id, files in captures.items()
            for name, number in files.items()
            if _is_gone(self._layout.capture(map_id, capture_id) / name)
        ]
        self._catalog.captures.forget_parts(lost)
        if lost:
            _log.warning("%d parts of captures are gone and have to be sent again", len(lost))
        return len(lost)

    def _folder(self, capture: CaptureSummary) -> Path:
        return self._layout.capture(capture.map_id, capture.id)

    def _put_together(self, capture: CaptureRecord, folder: Path, progress: Progress) -> None:
        whole = hashlib.sha256()
        pieces = self._pieces(capture, progress)
        rest = memoryview(b"")
        with named_disk_errors():
            folder.mkdir(0o700)
            for name, size_bytes in capture.files:
                left = size_bytes
                with (folder / name).open("xb") as file:
                    while left:
                        if not rest:
                            rest = memoryview(next(pieces))
                            whole.update(rest)
                        taken, rest = rest[:left], rest[left:]
                        file.write(taken)
                        left -= len(taken)
        if capture.digest not in {None, whole.hexdigest()}:
            raise CaptureMismatch(
                f"capture {capture.id} was announced with digest {capture.digest}, its files have"
                f" {whole.hexdigest()}: delete it and upload it again"
            )

    def _pieces(self, capture: CaptureRecord, progress: Progress) -> Iterator[bytes]:
        """Yield the parts, each checked against its digest; forget those that are damaged."""
        stored = self._catalog.captures.parts(capture.id)
        lost = []
        progress.start("putting together", capture.parts)
        for number in range(capture.parts):
            digest, name = stored.get(number, ("", ""))
            try:
                content = (self._folder(capture) / name).read_bytes() if name else b""
            except FileNotFoundError:
                content = b""
            if hashlib.sha256(content).hexdigest() != digest:
                self._catalog.captures.forget_parts([(capture.id, number, name)])
                lost.append(number)
                content = bytes(capture.size_of(number) or 0)  # to find all that are damaged
            progress.advance()
            if number == capture.parts - 1 and lost:
                again = ranges_text(index_ranges(lost))
                raise PartsMissing(
                    f"parts {again} of capture {capture.id} are damaged or gone: send"
                    " them again, and complete it"
                )
            yield content


def _require_fit(capture: CaptureSummary, number: int, size_bytes: int) -> None:
    wanted = capture.size_of(number)
    if wanted is None:
        raise PartDoesNotFit(
            f"capture {capture.id} has parts 0 to {capture.parts - 1}, there is no {number}"
        )
    if size_bytes != wanted:
        raise PartDoesNotFit(
            f"part {number} of capture {capture.id} has {size_bytes} bytes, wanted {wanted}: parts"
            f" of {capture.part_bytes}, {capture.size_bytes} together"
        )


def _is_gone(path: Path) -> bool:
    """Return whether a file is not there; one that the disk does not show now may be."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        pass
    return False


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return -1
