"""The copy of a catalog that a backup has, and what it names."""

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from storage.errors import CorruptFile, StorageFull, StorageUnavailable
from storage.files.stored_file import StoredFile
from storage.store.catalog_url import uri_of
from storage.store.layout import Layout

# Of SQLite; the last for what is no catalog, as it lacks a table.
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
_SCANS = """SELECT drives.map_id, drives.id, chunk, chunk_row, scan_index, digest FROM scans
            JOIN drives ON drives.id = scans.drive_id WHERE chunk <> ''"""  # to sort takes a file
_WITHOUT_RETURNS = """SELECT map_id, id FROM drives
                      WHERE EXISTS (SELECT 1 FROM scans WHERE drive_id = drives.id AND chunk = '')
                      ORDER BY 1, 2"""
_SLUGS = "SELECT id, slug FROM maps UNION ALL SELECT id, slug FROM drives"
_DELETED_SLUGS = "SELECT id, slug FROM recycle_bin"
_HAS_RECYCLE_BIN = "SELECT 1 FROM sqlite_master WHERE name = 'recycle_bin'"  # since 0016
_BASES = "SELECT file_name, digest FROM bases ORDER BY 1"
_HAS_BASES = "SELECT 1 FROM sqlite_master WHERE name = 'bases'"  # catalogs before 0013 have none
_REVISIONS = "SELECT map_id, file_name, digest FROM revisions ORDER BY 1, 2"


def copy_catalog(catalog: Path, copy: Path) -> None:
    """Copy a SQLite database as it is between two transactions, and check the copy.

    Raises:
        OSError: If no space is left for the copy.
        StorageUnavailable: If it cannot be copied for another reason.
        CorruptFile: If the copy is damaged.
    """
    copy.unlink(missing_ok=True)
    try:
        with (
            closing(sqlite3.connect(uri_of(catalog), uri=True)) as source,
            closing(sqlite3.connect(copy)) as target,
        ):
            source.backup(target)
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            raise OSError(errno.ENOSPC, str(error), str(copy)) from error
        raise StorageUnavailable(f"the catalog cannot be copied: {error}") from error
    require_sound(copy)


def _query(catalog: Path, statement: str) -> list[Any]:
    return list(_rows(catalog, statement))


def _rows(catalog: Path, statement: str) -> Iterator[Any]:
    """Yield what a copy of a catalog answers.

    Raises:
        CorruptFile: If it is damaged or no catalog.
        StorageFull: If no space is left for the temporary files of SQLite.
        StorageUnavailable: If it cannot be read for another reason.
    """
    # Nobody writes into a copy: immutable, it needs no file of shared memory beside it.
    uri = f"{catalog.absolute().as_uri()}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(uri, uri=True)) as connection:
            yield from connection.execute(statement)
    except (sqlite3.Error, UnicodeDecodeError) as error:
        code = getattr(error, "sqlite_errorcode", None)  # none of a text that cannot be decoded
        if code == sqlite3.SQLITE_FULL:
            raise StorageFull(
                "no space is left for temporary files, which reading the catalog takes: free some"
            ) from error
        is_damaged = code is None or code & 0xFF in _DAMAGED or not catalog.exists()
        kind = CorruptFile if is_damaged else StorageUnavailable
        raise kind(f"the copy of the catalog cannot be read: {error}") from error


def named_files(catalog: Path) -> list[StoredFile]:
    """Return all files that a copy of a catalog names, those of each kind in order of their paths.

    Raises:
        CorruptFile: If it is no catalog.
    """
    layout = Layout(Path())
    of_scans: dict[tuple[str, str, str], tuple[dict[int, str], dict[int, int]]] = {}
    for map_id, drive_id, chunk, row, index, digest in _rows(catalog, _SCANS):
        digests, indices = of_scans.setdefault((map_id, drive_id, chunk), ({}, {}))
        digests[row], indices[row] = digest, index
    chunks = (
        StoredFile(str(layout.chunks(map_id, drive_id) / chunk), digests, indices)
        for (map_id, drive_id, chunk), (digests, indices) in sorted(
            of_scans.items(), key=lambda item: item[0]
        )
    )
    revisions = (
        StoredFile(str(layout.revisions(map_id) / name), revision=digest)
        for map_id, name, digest in _query(catalog, _REVISIONS)
    )
    bases = [
        StoredFile(str(layout.bases / name), basis=digest)
        for name, digest in (_query(catalog, _BASES) if _query(catalog, _HAS_BASES) else ())
    ]
    return [*chunks, *revisions, *bases]


def store_id_of(catalog: Path) -> str:
    """Return the id of the store that a copy of a catalog belongs to.

    Raises:
        CorruptFile: If it has none.
    """
    for (store_id,) in _query(catalog, "SELECT id FROM store"):
        return str(store_id)
    raise CorruptFile("the catalog belongs to no store")


def require_sound(catalog: Path) -> None:
    """Raise `CorruptFile` if a copy of a catalog is damaged."""
    [(result,), *_] = _query(catalog, "PRAGMA integrity_check")
    if result != "ok":
        raise CorruptFile(f"the copy of the catalog is damaged: {result}")


def slugs_of(catalog: Path) -> dict[str, str]:
    """Return the slugs of the maps and drives of a copy, by id; deleted ones' as before."""
    slugs = dict(_query(catalog, _SLUGS))
    if _query(catalog, _HAS_RECYCLE_BIN):
        slugs |= dict(_query(catalog, _DELETED_SLUGS))
    return slugs


def without_returns(catalog: Path) -> list[tuple[str, str]]:
    """Return map and drive of each drive that lacks returns."""
    return _query(catalog, _WITHOUT_RETURNS)
