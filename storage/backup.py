"""Backups: one tar file of a data directory, made while the service runs.

    maps/...           every file that the catalog names, as in the data directory, and images
    store-id           which catalog and directory belong together
    catalog.sqlite3    the catalog as it was at one moment
    manifest.json      size and SHA-256 of all that belongs to the backup

Files never change, so the catalog's copy says which ones belong together. A file that was deleted
before it could be copied is in a catalog of the past only: then the catalog is copied again, and
what is missing in the backup is added. So catalog and manifest stand at the end, and a file more
than the manifest names may stand before them.

Images that builds cache are left out where a build can make them anew; those of drives whose
returns were dropped are the only source that is left, and are in the backup.
"""

import hashlib
import io
import json
import os
import sqlite3
import tarfile
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from storage.drive_chunks import ChunkFile, scan_digest
from storage.errors import CorruptFile, StorageBusy, StorageUnavailable
from storage.files import named_disk_errors, publish
from storage.map_file import read_map
from storage.store.layout import Layout

__all__ = [
    "CATALOG",
    "FORMAT",
    "FORMAT_VERSION",
    "MANIFEST",
    "STORE_ID",
    "Backup",
    "NamedFile",
    "named_files",
    "store_id_of",
    "write_backup",
]

FORMAT, FORMAT_VERSION = "tensormap-backup", 1
CATALOG, STORE_ID, MANIFEST = "catalog.sqlite3", "store-id", "manifest.json"

_PASSES = 50  # each one that fails met a deletion or compaction, which are rare
_SCANS = """SELECT drives.map_id, drives.id, chunk, chunk_row, digest FROM scans
            JOIN drives ON drives.id = scans.drive_id WHERE chunk <> '' ORDER BY 1, 2, 3, 4"""
_WITHOUT_RETURNS = """SELECT DISTINCT drives.map_id, drives.id FROM scans
                      JOIN drives ON drives.id = scans.drive_id WHERE chunk = '' ORDER BY 1, 2"""
_REVISIONS = "SELECT map_id, file_name, digest FROM revisions ORDER BY 1, 2"


@dataclass(frozen=True)
class NamedFile:
    """A file that a catalog names.

    Attributes:
        path: Under the data directory.
        scans: Digests of the scans that the catalog finds in it, by row.
        revision: Digest of the revision that it holds, `None` if it holds scans.
    """

    path: str
    scans: Mapping[int, str]
    revision: str | None


@dataclass(frozen=True)
class Backup:
    """What was written.

    Attributes:
        files: How many files of scans and revisions.
        size_bytes: Of the backup.
        damaged: What is not as it was stored, in words; it is in the backup as it is.
    """

    files: int
    size_bytes: int
    damaged: tuple[str, ...]


def write_backup(data_dir: Path, output: Path) -> Backup:
    """Copy a data directory whose catalog is its own SQLite file; the service may run.

    Every scan and revision is checked against its digest on the way.

    Args:
        data_dir: The data directory.
        output: The tar file to write; it appears whole, readable by this user only.

    Raises:
        FileNotFoundError: If the directory holds no catalog.
        CorruptFile: If the catalog is damaged, or a file that it names is gone.
        StorageBusy: If files are deleted faster than they are copied.
        StorageFull: If no space is left for the backup; nothing is left behind.
    """
    layout = Layout(data_dir.absolute())
    if not layout.catalog.is_file():
        raise FileNotFoundError(2, "holds no catalog", str(data_dir))
    written: dict[str, dict[str, object]] = {}
    damaged: dict[str, str] = {}
    with (
        publish(output) as part,
        TemporaryDirectory(prefix=".backup-", dir=output.absolute().parent) as folder,
    ):
        copy = Path(folder) / CATALOG
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with (
            named_disk_errors(),
            os.fdopen(descriptor, "wb") as sink,
            tarfile.open(fileobj=sink, mode="w", format=tarfile.PAX_FORMAT) as tar,
        ):
            named = _copy_files(layout, copy, tar, written, damaged)
            kept = {path: written[path] for path in named}
            for image in _only_images(layout, copy):
                with suppress(FileNotFoundError), (layout.data_dir / image).open("rb") as source:
                    kept[image] = _add(tar, image, source)  # or its drive was deleted meanwhile
            kept[STORE_ID] = _add_bytes(tar, STORE_ID, f"{store_id_of(copy)}\n".encode())
            with copy.open("rb") as source:
                kept[CATALOG] = _add(tar, CATALOG, source)
            manifest = {"format": FORMAT, "format_version": FORMAT_VERSION, "files": kept}
            _add_bytes(tar, MANIFEST, json.dumps(manifest, indent=1).encode())
        size_bytes = part.stat().st_size
    told = tuple(said for path, said in damaged.items() if path in named)
    return Backup(len(named), size_bytes, told)


def _copy_files(
    layout: Layout,
    copy: Path,
    tar: tarfile.TarFile,
    written: dict[str, dict[str, object]],
    damaged: dict[str, str],
) -> set[str]:
    """Copy catalog and files until they belong together; return the paths of these files."""
    missing: str | None = None
    for _ in range(_PASSES):
        _copy_catalog(layout.catalog, copy)
        files = named_files(copy)
        if missing is not None and missing in {file.path for file in files}:
            raise CorruptFile(f"the catalog names {missing}, and it is gone")
        missing = None
        for file in files:
            if file.path in written:
                continue
            try:
                with (layout.data_dir / file.path).open("rb") as source:
                    if (said := _check(Path(f"/proc/self/fd/{source.fileno()}"), file)) is not None:
                        damaged[file.path] = said
                    written[file.path] = _add(tar, file.path, source)
            except FileNotFoundError:
                missing = file.path
                break
        else:
            return {file.path for file in files}
    raise StorageBusy(f"files were deleted {_PASSES} times while they were copied: try again")


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
    except sqlite3.Error as error:
        raise StorageUnavailable(f"the catalog cannot be copied: {error}") from error
    if said != "ok":
        raise CorruptFile(f"the catalog is damaged: {said}")


def named_files(catalog: Path) -> list[NamedFile]:
    """Return all files that a catalog names, in the order of their paths.

    Raises:
        CorruptFile: If it is no catalog.
    """
    layout = Layout(Path())
    scans: dict[str, dict[int, str]] = {}
    try:
        with closing(sqlite3.connect(catalog)) as connection:
            for map_id, drive_id, chunk, row, digest in connection.execute(_SCANS):
                path = str(layout.chunks(map_id, drive_id) / chunk)
                scans.setdefault(path, {})[row] = digest
            revisions = [
                NamedFile(str(layout.revisions(map_id) / name), {}, digest)
                for map_id, name, digest in connection.execute(_REVISIONS)
            ]
    except sqlite3.Error as error:
        raise CorruptFile(f"the backup's catalog cannot be read: {error}") from error
    return [*(NamedFile(path, rows, None) for path, rows in scans.items()), *revisions]


def store_id_of(catalog: Path) -> str:
    """Return the id of the store that a catalog belongs to.

    Raises:
        CorruptFile: If it has none.
    """
    try:
        with closing(sqlite3.connect(catalog)) as connection:
            found = connection.execute("SELECT id FROM store").fetchone()
    except sqlite3.Error as error:
        raise CorruptFile(f"the catalog cannot be read: {error}") from error
    if found is None:
        raise CorruptFile("the catalog belongs to no store")
    return str(found[0])


def _check(path: Path, file: NamedFile) -> str | None:
    """Return what is wrong with a file, `None` if it is what was stored."""
    try:
        if file.revision is not None:
            found = read_map(path).revision
            if found == file.revision:
                return None
            return f"{file.path} holds revision {found}, not {file.revision}"
        chunk = ChunkFile(path)
        for row, wanted in file.scans.items():
            if scan_digest(chunk.points_m(row)) != wanted:
                return f"row {row} of {file.path} is not the scan that was put"
    except CorruptFile as error:
        return f"{file.path}: {error}"
    return None


def _add_bytes(tar: tarfile.TarFile, name: str, content: bytes) -> dict[str, object]:
    return _add(tar, name, io.BytesIO(content))


def _add(tar: tarfile.TarFile, name: str, source: BinaryIO) -> dict[str, object]:
    """Add a file; return what the manifest says about it."""
    size = source.seek(0, os.SEEK_END)
    source.seek(0)
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o600
    hashed = _Hashed(source)
    tar.addfile(member, hashed)  # all that it calls is `read`
    return {"size": size, "sha256": hashed.digest.hexdigest()}


class _Hashed:
    """A file that is hashed while it is read."""

    def __init__(self, source: BinaryIO) -> None:
        self._source = source
        self.digest = hashlib.sha256()

    def read(self, size: int = -1) -> bytes:
        """Read on."""
        content = self._source.read(size)
        self.digest.update(content)
        return content
