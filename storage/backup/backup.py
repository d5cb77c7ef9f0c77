"""Backups: one tar file of a data directory, made while the service runs.

    maps/...           every file that the catalog names, as in the data directory, and images
    store-id           which catalog and directory belong together
    catalog.sqlite3    the catalog as it was at one moment
    manifest.json      size and SHA-256 of all that belongs to the backup, and what it lacks

Files never change, so the catalog's copy says which ones belong together. A file that was deleted
before it could be copied is in a catalog of the past only: then the catalog is copied again, and
what is missing in the backup is added. So catalog and manifest stand at the end, and a file more
than the manifest names may stand before them.

A file that is damaged is in the backup as it is. One that is gone, or that the disk does not give,
is not: the manifest says so, and the rest is a backup. Files are checked in a process of their own,
so that damage that keeps a reader busy for ever ends neither here.

Images that builds cache are left out where a build can make them anew; those of drives whose
returns were dropped are the only source that is left, and are in the backup.
"""

import hashlib
import io
import json
import os
import sqlite3
import stat
import tarfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, TypeVar

from storage.errors import CorruptFile, StorageBusy, StorageUnavailable
from storage.files.checker import Checker
from storage.files.claims import abandoned_copies, claimed, remove_abandoned
from storage.files.files import named_disk_errors, publish
from storage.files.stored_file import StoredFile
from storage.store.layout import Layout

FORMAT, FORMAT_VERSION = "tensormap-backup", 1
CATALOG, STORE_ID, MANIFEST = "catalog.sqlite3", "store-id", "manifest.json"

T = TypeVar("T")

_LACKING = ("damaged", "missing")
_PASSES = 50  # each one that fails met a deletion or compaction, which are rare
_SCANS = """SELECT drives.map_id, drives.id, chunk, chunk_row, scan_index, digest FROM scans
            JOIN drives ON drives.id = scans.drive_id WHERE chunk <> '' ORDER BY 1, 2, 3, 4"""
_WITHOUT_RETURNS = """SELECT DISTINCT drives.map_id, drives.id FROM scans
                      JOIN drives ON drives.id = scans.drive_id WHERE chunk = '' ORDER BY 1, 2"""
_SLUGS = "SELECT id, slug FROM maps UNION ALL SELECT id, slug FROM drives"
_REVISIONS = "SELECT map_id, file_name, digest FROM revisions ORDER BY 1, 2"


@dataclass(frozen=True)
class Backup:
    """What was written.

    Attributes:
        path: Where it is.
        files: How many files of scans and revisions.
        size_bytes: Of the backup.
        damaged: What is not as it was stored, in words; it is in the backup as it is.
        missing: What the catalog names and the backup lacks, in words.
    """

    path: Path
    files: int
    size_bytes: int
    damaged: tuple[str, ...]
    missing: tuple[str, ...]


def write_backup(data_dir: Path, output: Path) -> Backup:
    """Copy a data directory whose catalog is its own SQLite file; the service may run.

    Every scan and revision is checked against its digest on the way. A backup in which something is
    damaged or missing replaces no file that is at `output`: it goes beside it, `backup.tar` to
    `backup.incomplete.tar`, where it replaces an earlier one.

    Args:
        data_dir: The data directory.
        output: The tar file to write; it appears whole, readable by this user only.

    Raises:
        FileNotFoundError: If the directory holds no catalog.
        CorruptFile: If the catalog is damaged.
        StorageBusy: If files are deleted faster than they are copied.
        StorageFull: If no space is left for the backup; nothing is left behind.
    """
    layout = Layout(data_dir.absolute())
    if not layout.catalog.is_file():
        raise FileNotFoundError(2, "holds no catalog", str(data_dir))
    folder = output.absolute().parent
    for left in (*abandoned_copies(folder), *folder.glob(f".{output.name}.*.part")):
        remove_abandoned(left)
    copied = _Copied()
    path = output
    with publish(output, instead=lambda: path) as part, ExitStack() as stack:
        copy = stack.enter_context(_folder_beside(output)) / CATALOG
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with (
            named_disk_errors(),
            os.fdopen(descriptor, "wb") as sink,
            claimed(part),
            Checker() as checker,
            tarfile.open(fileobj=sink, mode="w", format=tarfile.PAX_FORMAT) as tar,
        ):
            named = _copy_files(layout, copy, tar, copied, checker)
            for image in _only_images(layout, copy):
                named.add(image)
                _copy_image(layout, image, tar, copied, checker)
            kept = {path: told for path, told in copied.written.items() if path in named}
            kept[STORE_ID] = _add_bytes(tar, STORE_ID, f"{store_id_of(copy)}\n".encode())
            with copy.open("rb") as source:
                kept[CATALOG] = _add(tar, CATALOG, source)
            manifest = {"format": FORMAT, "format_version": FORMAT_VERSION, "files": kept}
            for kind, told in zip(_LACKING, (copied.damaged, copied.missing), strict=True):
                if wrong := {path: said for path, said in told.items() if path in named}:
                    manifest[kind] = wrong
            _add_bytes(tar, MANIFEST, json.dumps(manifest, indent=1).encode())
        size_bytes = part.stat().st_size
        if manifest.keys() & _LACKING and output.exists():
            path = output.with_name(f"{output.stem}.incomplete{output.suffix}")
    return Backup(
        path,
        sum(1 for path in kept if path.startswith("maps/") and "/images/" not in path),
        size_bytes,
        tuple(f"{said} ({path})" for path, said in copied.damaged.items() if path in named),
        tuple(f"{said} ({path})" for path, said in copied.missing.items() if path in named),
    )


@dataclass
class _Copied:
    """What became of the files: what the manifest says of each, or in words what is wrong.

    Attributes:
        slugs: Of maps and drives, by id.
    """

    slugs: dict[str, str] = field(default_factory=dict)
    written: dict[str, dict[str, object]] = field(default_factory=dict)
    damaged: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)


@contextmanager
def _folder_beside(output: Path) -> Iterator[Path]:
    prefix, parent = ".tensormap-backup-", output.absolute().parent
    with TemporaryDirectory(prefix=prefix, dir=parent) as folder, claimed(Path(folder)):
        yield Path(folder)


def _copy_files(
    layout: Layout, copy: Path, tar: tarfile.TarFile, copied: _Copied, checker: Checker
) -> set[str]:
    """Copy catalog and files until they belong together; return the paths of these files.

    A file that is gone, and that a copy of the catalog which was made after that still names, is
    missing; else it was deleted or moved while the backup was made.
    """
    gone: set[str] = set()
    for _ in range(_PASSES):
        _copy_catalog(layout.catalog, copy)
        files = named_files(copy)
        copied.slugs = _slugs(copy)
        first_gone = False
        for file in files:
            if file.path in copied.written or file.path in copied.missing:
                continue
            try:
                _copy_file(layout, file, tar, copied, checker)
            except FileNotFoundError:
                if file.path in gone:
                    described = file.described(copied.slugs)
                    copied.missing[file.path] = f"{described}: the file is gone"
                else:
                    gone.add(file.path)
                    first_gone = True
        if not first_gone:
            return {file.path for file in files}
    raise StorageBusy(f"files were deleted {_PASSES} times while they were copied: try again")


def _copy_file(
    layout: Layout, file: StoredFile, tar: tarfile.TarFile, copied: _Copied, checker: Checker
) -> None:
    path = layout.data_dir / file.path
    try:
        if not stat.S_ISREG(_of_source(path.stat).st_mode):
            raise _SourceError("it is no file")
        if (fault := checker.fault(path, file)) is not None:
            described = file.described(copied.slugs, fault.good_rows)
            copied.damaged[file.path] = f"{described}: {fault.what}"
        with _of_source(lambda: path.open("rb")) as source:
            copied.written[file.path] = _add(tar, file.path, source)
    except FileNotFoundError:
        copied.damaged.pop(file.path, None)
        raise
    except _SourceError as error:
        copied.damaged.pop(file.path, None)
        described = file.described(copied.slugs)
        copied.missing[file.path] = f"{described}: the file cannot be read: {error}"


def _of_source(do: Callable[[], T]) -> T:
    """Do something with a file that is to be copied; what fails is its fault, not the backup's."""
    try:
        return do()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise _SourceError(str(error)) from error


def _copy_image(
    layout: Layout, image: str, tar: tarfile.TarFile, copied: _Copied, checker: Checker
) -> None:
    with suppress(FileNotFoundError):  # its drive was deleted meanwhile
        _copy_file(layout, StoredFile(image), tar, copied, checker)


def _only_images(layout: Layout, catalog: Path) -> list[str]:
    """Return the paths of the images of drives that lack returns."""
    with closing(sqlite3.connect(catalog)) as connection:
        drives = connection.execute(_WITHOUT_RETURNS).fetchall()
    return [
        str(path.relative_to(layout.data_dir))
        for map_id, drive_id in drives
        for path in sorted(layout.images(map_id, drive_id).glob("*.h5"))
    ]


def _copy_catalog(catalog: Path, copy: Path) -> None:
    """Copy a SQLite database as it is between two transactions, and check the copy."""
    copy.unlink(missing_ok=True)
    try:
        with (
            closing(sqlite3.connect(f"{catalog.as_uri()}?mode=rw", uri=True)) as source,
            closing(sqlite3.connect(copy)) as target,
        ):
            source.backup(target)
            [(said,), *_] = target.execute("PRAGMA integrity_check")
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise StorageUnavailable(f"the catalog cannot be copied: {error}") from error
    if said != "ok":
        raise CorruptFile(f"the catalog is damaged: {said}")


def named_files(catalog: Path) -> list[StoredFile]:
    """Return all files that a catalog names, in the order of their paths.

    Raises:
        CorruptFile: If it is no catalog.
    """
    layout = Layout(Path())
    scans: dict[str, dict[int, str]] = {}
    indices: dict[str, dict[int, int]] = {}
    try:
        with closing(sqlite3.connect(catalog)) as connection:
            for map_id, drive_id, chunk, row, index, digest in connection.execute(_SCANS):
                path = str(layout.chunks(map_id, drive_id) / chunk)
                scans.setdefault(path, {})[row] = digest
                indices.setdefault(path, {})[row] = index
            revisions = [
                StoredFile(str(layout.revisions(map_id) / name), revision=digest)
                for map_id, name, digest in connection.execute(_REVISIONS)
            ]
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise CorruptFile(f"the backup's catalog cannot be read: {error}") from error
    chunks = (StoredFile(path, digests, indices[path]) for path, digests in scans.items())
    return [*chunks, *revisions]


def _slugs(copy: Path) -> dict[str, str]:
    # Nobody writes into the copy: immutable, it needs no file of shared memory beside it.
    try:
        with closing(sqlite3.connect(f"{copy.as_uri()}?immutable=1", uri=True)) as connection:
            return dict(connection.execute(_SLUGS).fetchall())
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise CorruptFile(f"the copy of the catalog cannot be read: {error}") from error


def store_id_of(catalog: Path) -> str:
    """Return the id of the store that a catalog belongs to.

    Raises:
        CorruptFile: If it has none.
    """
    try:
        with closing(sqlite3.connect(catalog)) as connection:
            found = connection.execute("SELECT id FROM store").fetchone()
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise CorruptFile(f"the catalog cannot be read: {error}") from error
    if found is None:
        raise CorruptFile("the catalog belongs to no store")
    return str(found[0])


def _add_bytes(tar: tarfile.TarFile, name: str, content: bytes) -> dict[str, object]:
    return _add(tar, name, io.BytesIO(content))


def _add(tar: tarfile.TarFile, name: str, source: BinaryIO) -> dict[str, object]:
    """Add a file; return what the manifest says about it.

    Raises:
        _SourceError: If it cannot be read to its end: what the backup holds of it is of no use.
    """
    try:
        size = source.seek(0, os.SEEK_END)
        source.seek(0)
    except OSError as error:
        raise _SourceError(str(error)) from error
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o600
    hashed = _Hashed(source, size)
    tar.addfile(member, hashed)  # all that it calls is `read`
    if hashed.fault is not None:
        raise _SourceError(hashed.fault)
    return {"size": size, "sha256": hashed.digest.hexdigest()}


class _SourceError(Exception):
    """A file that the disk does not give."""


class _Hashed:
    """A file that is hashed while it is read; where it cannot be, zeros take its place.

    A tar has told a member's size before its content: the next one begins where that ends.
    """

    def __init__(self, source: BinaryIO, size: int) -> None:
        self._source = source
        self._left = size
        self.digest = hashlib.sha256()
        self.fault: str | None = None

    def read(self, size: int = -1, /) -> bytes:
        """Read on."""
        wanted = self._left if size < 0 else min(size, self._left)
        content = b"" if self.fault is not None else self._content(wanted)
        if len(content) < wanted:
            self.fault = self.fault or "it became shorter while it was copied"
            content = content.ljust(wanted, b"\0")
        self._left -= wanted
        self.digest.update(content)
        return content

    def _content(self, size: int) -> bytes:
        try:
            return self._source.read(size)
        except OSError as error:
            self.fault = str(error)
            return b""
