"""Restores: from a backup to a new data directory, or to nothing at all."""

import hashlib
import json
import os
import re
import shutil
import sqlite3
import tarfile
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from core.errors import InvalidParameters
from storage.backup.backup import (
    CATALOG,
    FORMAT,
    FORMAT_VERSION,
    MANIFEST,
    STORE_ID,
    named_files,
    store_id_of,
)
from storage.errors import CorruptFile
from storage.files.claims import claimed, remove_abandoned
from storage.files.files import make_folder, named_disk_errors, sync

_BLOCK_BYTES = 2**20
_MOST_MANIFEST_BYTES = 2**30
# All that a backup may hold: nothing else becomes a path.
_NAMES = re.compile(
    r"catalog\.sqlite3|store-id|manifest\.json"
    r"|maps/[0-9a-f]{32}/drives/[0-9a-f]{32}/chunks/[0-9a-f]{32}\.h5"
    r"|maps/[0-9a-f]{32}/drives/[0-9a-f]{32}/images/[a-z]{1,20}-[0-9a-f]{16}-[0-9a-f]{32}\.h5"
    r"|maps/[0-9a-f]{32}/revisions/[0-9a-f]{64}\.[0-9a-f]{8}\.h5"
)


@dataclass(frozen=True)
class Restored:
    """What was restored.

    Attributes:
        files: How many files of scans and revisions.
        damaged: What was damaged before the backup, in words; it is restored as it was.
        missing: What the backup lacks, in words: it was gone, or could not be read, before.
    """

    files: int
    damaged: tuple[str, ...]
    missing: tuple[str, ...]


def restore_backup(backup: Path, data_dir: Path) -> Restored:
    """Make a data directory of a backup, all of it checked.

    The directory appears whole, or not at all; it lacks what the manifest says that the backup
    lacks, and serves the rest.

    Raises:
        InvalidParameters: If there is something at `data_dir` already.
        CorruptFile: If the backup is none, is cut off, or is not what was written.
        StorageFull: If no space is left; nothing is left behind.
    """
    target = data_dir.absolute()
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InvalidParameters(f"{data_dir} is there already: restore into a new folder")
    make_folder(target.parent)
    for left in target.parent.glob(f".{target.name}.restore-*"):
        remove_abandoned(left)
    with named_disk_errors():
        staging = Path(mkdtemp(prefix=f".{target.name}.restore-", dir=target.parent))
    try:
        with named_disk_errors(), claimed(staging):
            restored = _restore(backup, staging)
            staging.rename(target)
            sync(target.parent)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    return restored


def _restore(backup: Path, folder: Path) -> Restored:
    found = _unpack(backup, folder)
    whole = _manifest(folder / MANIFEST)
    manifest, lacks = whole["files"], whole["missing"]
    for name, told in manifest.items():
        if found.get(name) != told:
            raise CorruptFile(f"the backup's {name} is not what was written")
    for name in found.keys() - manifest.keys() - {MANIFEST}:  # deleted while the backup was made
        _remove(folder, name)
    named = {file.path for file in named_files(folder / CATALOG)}
    if missing := sorted(named - manifest.keys() - lacks.keys()):
        raise CorruptFile(f"the backup lacks {missing[0]} ({len(missing)} in all)")
    _check_catalog(folder)
    make_folder(folder / "maps")
    for path, _, names in os.walk(folder, topdown=False):
        for name in names:
            sync(Path(path, name))
        sync(Path(path))
    return Restored(len(named & manifest.keys()), _said(whole["damaged"]), _said(lacks))


def _said(of_each: dict[str, Any]) -> tuple[str, ...]:
    return tuple(f"{said} ({path})" for path, said in sorted(of_each.items()))


def _remove(folder: Path, name: str) -> None:
    """Remove a file, and the folders that held nothing else."""
    path = folder / name
    path.unlink()
    while (path := path.parent) != folder and not any(path.iterdir()):
        path.rmdir()


def _unpack(backup: Path, folder: Path) -> dict[str, dict[str, object]]:
    """Write what a backup holds under a folder; return its sizes and digests."""
    found: dict[str, dict[str, object]] = {}
    try:
        with tarfile.open(backup, "r:") as tar:
            for member in tar:
                name = member.name
                if not _NAMES.fullmatch(name) or not member.isreg() or member.sparse:
                    raise CorruptFile(f"{name[:200]!r} cannot be part of a backup")
                if name in found:
                    raise CorruptFile(f"the backup holds {name} twice")
                found[name] = _write(tar, member, folder / name)
    except (tarfile.TarError, ValueError, EOFError) as error:
        raise CorruptFile(f"{backup} is no backup, or cut off: {error}") from error
    return found


def _write(tar: tarfile.TarFile, member: tarfile.TarInfo, path: Path) -> dict[str, object]:
    source = tar.extractfile(member)
    if source is None:
        raise CorruptFile(f"the backup's {member.name} has no content")
    make_folder(path.parent)
    digest = hashlib.sha256()
    size = 0
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as sink:
        while block := source.read(_BLOCK_BYTES):
            sink.write(block)
            digest.update(block)
            size += len(block)
    return {"size": size, "sha256": digest.hexdigest()}


def _manifest(path: Path) -> dict[str, Any]:
    """Return the manifest's `files`, `damaged` and `missing`, by path, and remove it."""
    try:
        if path.stat().st_size > _MOST_MANIFEST_BYTES:
            raise CorruptFile("the backup's manifest is too long to be one")
        manifest = json.loads(path.read_bytes())
        kind = (manifest["format"], manifest["format_version"])
        told = {kind: dict(manifest.get(kind, {})) for kind in ("damaged", "missing")}
        told["files"] = files = dict(manifest["files"])
    except FileNotFoundError:
        raise CorruptFile("the backup has no manifest: it is cut off, or none") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise CorruptFile(f"the backup's manifest cannot be read: {error}") from error
    if kind != (FORMAT, FORMAT_VERSION):
        raise CorruptFile(f"the backup is a {kind}, wanted {(FORMAT, FORMAT_VERSION)}")
    if missing := {CATALOG, STORE_ID} - files.keys():
        raise CorruptFile(f"the backup's manifest lacks {min(missing)}")
    path.unlink()
    return told


def _check_catalog(folder: Path) -> None:
    try:
        with closing(sqlite3.connect(folder / CATALOG)) as connection:
            [(said,), *_] = connection.execute("PRAGMA integrity_check")
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise CorruptFile(f"the backup's catalog cannot be read: {error}") from error
    if said != "ok":
        raise CorruptFile(f"the backup's catalog is damaged: {said}")
    if (folder / STORE_ID).read_text().strip() != store_id_of(folder / CATALOG):
        raise CorruptFile("the backup's store-id is not its catalog's")
