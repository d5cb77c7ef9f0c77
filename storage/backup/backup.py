"""Backups: one tar file of a data directory, made while the service runs.

    store-id           the id that the catalog and its directory share
    maps/...           every file that the catalog names, as in the data directory, and images
    bases/...          likewise
    catalog.sqlite3    the catalog as it was at one moment
    manifest.json      size and SHA-256 of all that belongs to the backup, and what it lacks

Files never change, so the catalog's copy shows which files belong together. If a file was deleted
before it could be copied, the catalog is copied again, and the files that the backup still lacks
are added. So catalog and manifest are at the end, and there may be files before them that the
manifest does not name.

A damaged file is in the backup as it is. A file that is gone or cannot be read is not: the manifest
lists it, and the rest is a backup. Files are checked in a process of their own, so that damage that
makes a reader loop does not stop the backup.

Images that builds cache are left out where a build can make them again; those of drives whose
returns were dropped are the only copy, and are in the backup, or missing if there are none.
"""

import hashlib
import io
import json
import os
import shutil
import stat
import tarfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, BinaryIO, TypeVar

from core.progress import NO_PROGRESS, Progress
from storage.backup.catalog_copy import (
    copy_catalog,
    named_files,
    slugs_of,
    store_id_of,
    without_returns,
)
from storage.backup.member_names import may_be_member
from storage.errors import StorageBusy
from storage.files.checker import Checker
from storage.files.claims import claimed, remove_abandoned
from storage.files.files import entries, hidden_files_of, named_disk_errors, publish
from storage.files.free_space import OF_NOTHING, OF_SCANS
from storage.files.stored_file import StoredFile
from storage.store.identity import require_same_store
from storage.store.layout import ANY_IMAGES, CATALOG, STORE_ID, Layout
from storage.store.leftovers import abandoned_copies

FORMAT, FORMAT_VERSION = "tensormap-backup", 1
MANIFEST = "manifest.json"

T = TypeVar("T")

_MOST_ID_BYTES = 100
_PASSES = 50  # each one that fails met a deletion or compaction, which are rare


@dataclass(frozen=True)
class Backup:
    """What was written.

    Attributes:
        path: The backup's file.
        files: Number of files of scans, revisions and shared bases.
        size_bytes: Size of the backup.
        damaged: Descriptions of files that are not as they were stored; the backup has them as
            they are.
        missing: Descriptions of files that the catalog names and the backup lacks.
    """

    path: Path
    files: int
    size_bytes: int
    damaged: tuple[str, ...]
    missing: tuple[str, ...]


def file_of(output: Path) -> Path:
    """Return the file that is written for an output: of a link what it leads to, as on a NAS."""
    return Path(os.path.realpath(output)) if output.is_symlink() else output


def incomplete_of(output: Path) -> Path:
    """Return the file of a backup that is incomplete, where `output` is there already."""
    return output.with_name(f"{output.stem}.incomplete{output.suffix}")


def store_of(backup: Path) -> str | None:
    """Return the id of the store that a backup is of; `None` if it has none, as one cut off."""
    with suppress(tarfile.TarError), tarfile.open(backup, "r:") as tar:
        for member in tar:  # one of an earlier version has it behind its files
            if member.name == STORE_ID and (source := tar.extractfile(member)) is not None:
                return source.read(_MOST_ID_BYTES).decode(errors="replace").strip()
    return None


def write_backup(data_dir: Path, output: Path, progress: Progress = NO_PROGRESS) -> Backup:
    """Copy a data directory whose catalog is its own SQLite file; the service may run.

    Every scan and revision is checked against its digest. A backup in which something is damaged or
    missing replaces no file at `output`: it is written beside it, `backup.tar` to
    `backup.incomplete.tar`, where it replaces an earlier one.

    Args:
        data_dir: The data directory.
        output: The tar file to write; it appears whole, readable by this user only. A link stays.
        progress: Reports every file.

    Raises:
        FileNotFoundError: If the directory holds no catalog.
        CorruptFile: If the catalog is damaged.
        WrongCatalog: If the catalog belongs to another data directory; `output` stays as it is.
        StorageBusy: If files are deleted faster than they are copied.
        StorageFull: If less space is left than the files take, before any is copied, or none is
            left meanwhile; nothing is left behind.
    """
    output = file_of(output)
    layout = Layout(data_dir.absolute())
    if not layout.catalog.is_file():
        raise FileNotFoundError(2, "holds no catalog", str(data_dir))
    folder = output.absolute().parent
    for left in (*abandoned_copies(folder), *hidden_files_of(output)):
        remove_abandoned(left)
    path, where = output, f"the folder of {output}"
    with (
        ExitStack() as until_renamed,
        publish(output, instead=lambda: path, where=where) as part,
        ExitStack() as stack,
    ):
        catalog = stack.enter_context(_folder_beside(output)) / CATALOG

        def make() -> Path:
            part.touch(0o600, exist_ok=False)
            return part

        # Another backup may begin while this one is synced.
        until_renamed.enter_context(claimed(make))
        with (
            named_disk_errors(where),
            part.open("r+b") as sink,
            Checker() as checker,
            tarfile.open(fileobj=sink, mode="w", format=tarfile.PAX_FORMAT) as tar,
        ):
            copier = _Copier(layout, tar, checker, progress)
            named = copier.copy_files(catalog)
            kept, damaged, missing = (
                {path: fact for path, fact in facts.items() if path in named}
                for facts in (copier.written, copier.damaged, copier.missing)
            )
            with catalog.open("rb") as source:
                kept[CATALOG] = _add(tar, CATALOG, source)
            manifest = {"format": FORMAT, "format_version": FORMAT_VERSION, "files": kept}
            faults = {"damaged": damaged, "missing": missing}
            manifest |= {kind: of_kind for kind, of_kind in faults.items() if of_kind}
            _add(tar, MANIFEST, io.BytesIO(json.dumps(manifest, indent=1).encode()))
        size_bytes = part.stat().st_size
        if (damaged or missing) and output.exists():
            path = incomplete_of(output)
    return Backup(
        path,
        sum(1 for path in kept if path.startswith(("maps/", "bases/")) and "/images/" not in path),
        size_bytes,
        tuple(f"{what} ({path})" for path, what in damaged.items()),
        tuple(f"{what} ({path})" for path, what in missing.items()),
    )


@contextmanager
def _folder_beside(output: Path) -> Iterator[Path]:
    prefix, parent = ".tensormap-backup-", output.absolute().parent
    with claimed(lambda: Path(mkdtemp(prefix=prefix, dir=parent))) as folder:
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


class _Copier:
    """Copies files of a data directory into a tar.

    Attributes:
        written: What the manifest has of each file in the tar, by path; the store's id is first.
        damaged: Descriptions of files that are damaged, by path.
        missing: Descriptions of files that are gone or cannot be read, by path.
    """

    def __init__(
        self, layout: Layout, tar: tarfile.TarFile, checker: Checker, progress: Progress
    ) -> None:
        self._layout, self._tar, self._checker = layout, tar, checker
        self._progress = progress
        self._slugs: dict[str, str] = {}  # of maps and drives, by id
        self.written: dict[str, Any] = {}
        self.damaged: dict[str, Any] = {}
        self.missing: dict[str, Any] = {}

    def copy_files(self, catalog: Path) -> set[str]:
        """Copy the catalog to `catalog`, and its files, until they belong together.

        A file is missing if it is gone and a later copy of the catalog still names it; else it was
        deleted or moved meanwhile. So are the images of a drive that lacks returns.

        Returns:
            The paths of the files that the copy names, of those images and of the store's id.
        """
        gone: set[str] = set()
        for _ in range(_PASSES):
            copy_catalog(self._layout.catalog, catalog)
            store_id = store_id_of(catalog)
            require_same_store(store_id, self._layout)
            if not self.written:
                whole = io.BytesIO(f"{store_id}\n".encode())
                self.written[STORE_ID] = _add(self._tar, STORE_ID, whole)
            files = [*named_files(catalog), *self._images(catalog)]
            self._slugs = slugs_of(catalog)
            is_complete = True
            done = self.written.keys() | self.missing.keys()
            left = [file for file in files if file.path not in done]
            self._require_space(left, catalog)
            self._progress.start("copying", len(left))
            for file in left:
                try:
                    self._copy(file)
                except FileNotFoundError:
                    if file.path in gone:
                        described = file.described(self._slugs)
                        self.missing[file.path] = f"{described}: the file is gone"
                    else:
                        gone.add(file.path)
                        is_complete = False
                self._progress.advance()
            if is_complete:
                return {STORE_ID, *(file.path for file in files)}
        raise StorageBusy(f"files were deleted {_PASSES} times while they were copied: try again")

    def _require_space(self, files: Sequence[StoredFile], catalog: Path) -> None:
        """Reject a backup that does not fit, which would fill the disk before it fails.

        Where the service writes to the same disk, its catalog keeps the space of a deletion.
        """
        size_bytes = catalog.stat().st_size
        for file in files:
            with suppress(OSError):  # it is gone or cannot be read, and is listed as missing
                size_bytes += (self._layout.data_dir / file.path).stat().st_size
        is_same_disk = catalog.stat().st_dev == self._layout.catalog.stat().st_dev
        reserve = OF_SCANS if is_same_disk else OF_NOTHING
        reserve.require(catalog.parent, size_bytes, f"a backup in {catalog.parent.parent}")

    def _images(self, catalog: Path) -> Iterator[StoredFile]:
        """Yield the images of each drive that lacks returns; without any, one that is gone."""
        for map_id, drive_id in without_returns(catalog):
            folder = Layout(Path()).images(map_id, drive_id)
            found: list[Path] = []
            with suppress(OSError):  # of a folder that the disk cannot read, as if it were gone
                found = entries(self._layout.data_dir / folder)
            paths = sorted(str(folder / path.name) for path in found)
            images = [path for path in paths if may_be_member(path)]
            yield from map(StoredFile, images or [str(folder / ANY_IMAGES)])

    def _copy(self, file: StoredFile) -> None:
        path = self._layout.data_dir / file.path
        try:
            if not stat.S_ISREG(_of_source(path.stat).st_mode):
                raise _SourceError("it is no file")
            if (fault := self._checker.fault(path, file)) is not None:
                described = file.described(self._slugs, fault.good_rows)
                self.damaged[file.path] = f"{described}: {fault.what}"
            with _of_source(lambda: path.open("rb")) as source:
                self.written[file.path] = _add(self._tar, file.path, source)
        except FileNotFoundError:
            self.damaged.pop(file.path, None)
            raise
        except _SourceError as error:
            self.damaged.pop(file.path, None)
            described = file.described(self._slugs)
            self.missing[file.path] = f"{described}: the file cannot be read: {error}"


def _of_source(call: Callable[[], T]) -> T:
    """Call a function on a file to be copied; its errors are the file's, not the backup's."""
    try:
        return call()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise _SourceError(str(error)) from error


def _add(tar: tarfile.TarFile, name: str, source: BinaryIO) -> dict[str, object]:
    """Add a file; return what the manifest has of it.

    Raises:
        _SourceError: If it cannot be read to its end: its content in the backup is of no use.
    """
    try:
        size = source.seek(0, os.SEEK_END)
        source.seek(0)
    except OSError as error:
        raise _SourceError(str(error)) from error
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o600
    hashed = _Hashed(source, size)
    tar.addfile(member, hashed)  # calls `read` only
    if hashed.fault is not None:
        raise _SourceError(hashed.fault)
    return {"size": size, "sha256": hashed.digest.hexdigest()}


class _SourceError(Exception):
    """A file that the disk cannot read."""


class _Hashed:
    """A file that is hashed while it is read; what cannot be read is replaced by zeros.

    In a tar a member's size precedes its content: the next member begins where that ends.
    """

    def __init__(self, source: BinaryIO, size: int) -> None:
        self._source = source
        self._left = size
        self.digest = hashlib.sha256()
        self.fault: str | None = None

    def read(self, size: int = -1, /) -> bytes:
        """Return the next bytes."""
        count = self._left if size < 0 else min(size, self._left)
        content = b""
        if self.fault is None:
            try:
                content = self._source.read(count)
            except OSError as error:
                self.fault = str(error)
        if len(content) < count:
            self.fault = self.fault or "it became shorter while it was copied"
            content = content.ljust(count, b"\0")
        self._left -= count
        self.digest.update(content)
        return content
