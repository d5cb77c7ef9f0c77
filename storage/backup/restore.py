"""Restores: from a backup to a new data directory, which is whole or none."""

import hashlib
import json
import os
import shutil
import tarfile
from contextlib import ExitStack
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from core.errors import InvalidParameters
from core.progress import NO_PROGRESS, Progress
from storage.backup.backup import FORMAT, FORMAT_VERSION, MANIFEST
from storage.backup.catalog_copy import named_files, require_sound, store_id_of
from storage.backup.member_names import may_be_member
from storage.errors import CorruptFile
from storage.files.claims import claimed, remove_abandoned
from storage.files.files import make_folder, named_disk_errors, require_no_lost_link, sync
from storage.files.free_space import OF_NOTHING
from storage.store.clock import ClockWatch
from storage.store.identity import is_empty, names_in, store_id_in
from storage.store.layout import CATALOG, STORE_ID, Layout

_BLOCK_BYTES, _MB = 2**20, 10**6
_MOST_MANIFEST_BYTES = 2**30


@dataclass(frozen=True)
class Restored:
    """What was restored.

    Attributes:
        files: Number of files of scans, revisions and shared bases.
        damaged: Descriptions of files that were damaged before the backup; restored as they were.
        missing: Descriptions of files that the backup lacks: gone, or not readable, before it.
    """

    files: int
    damaged: tuple[str, ...]
    missing: tuple[str, ...]


def restore_backup(backup: Path, data_dir: Path, progress: Progress = NO_PROGRESS) -> Restored:
    """Make a data directory of a backup, after a check of all of it.

    A new folder appears whole, or not at all; it lacks only what the manifest lists as missing. An
    empty folder, as a mount point is, is filled after the check, by a few renames: if the process
    is killed within them, it leaves a part that no service opens.

    Args:
        backup: The backup's file.
        data_dir: The folder to make.
        progress: Reports every megabyte that is unpacked, then every file.

    Raises:
        OSError: If the backup cannot be opened, or `data_dir` is a link to a folder that is not
            there; nothing is made.
        InvalidParameters: If `data_dir` exists and is no empty folder.
        CorruptFile: If it is no backup, is cut off, or is not what was written.
        StorageFull: If less space is left than the backup's size, before any of it is unpacked, or
            none is left meanwhile; nothing is left behind.
    """
    with backup.open("rb"):
        pass  # its own error, before a folder is made, and not that of the folder
    target = data_dir.absolute()
    require_no_lost_link(target)
    is_folder = target.is_dir()
    folder, prefix = (
        (target, ".restore-") if is_folder else (target.parent, f".{target.name}.restore-")
    )
    make_folder(folder)
    for left in folder.glob(f"{escape(prefix)}*"):
        remove_abandoned(left)
    if target.exists() and not (is_folder and is_empty(target)):
        raise InvalidParameters(
            f"{data_dir} is there already: restore into a new folder or an empty one"
        )
    OF_NOTHING.require(folder, backup.stat().st_size, f"a restore into {folder}")
    with (
        named_disk_errors(),
        claimed(lambda: Path(mkdtemp(prefix=prefix, dir=folder))) as staging,
    ):
        try:
            restored = _restore(backup, staging, progress)
            if is_folder:
                _require_alone(staging, target)
                _move_all(staging, target)
            else:
                staging.rename(target)
                sync(folder)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    return restored


def _require_alone(staging: Path, target: Path) -> None:
    """Reject a folder into which something came meanwhile: a rename would replace a file.

    Of two restores into it each finds the other's staging folder.
    """
    for name in sorted(names_in(target) - {staging.name}):
        raise InvalidParameters(
            f"{target} was empty, and {name!r} is there meanwhile: restore into a new folder or an"
            " empty one"
        )


def _move_all(staging: Path, target: Path) -> None:
    """Move what is in a folder into another one, or nothing if that fails.

    The store-id is the last one: without it no service opens the catalog.
    """
    with ExitStack() as undo:

        def move(name: str) -> None:
            (staging / name).rename(target / name)
            undo.callback((target / name).rename, staging / name)

        for path in list(staging.iterdir()):
            if path.name != STORE_ID:
                move(path.name)
        sync(target)
        move(STORE_ID)
        sync(target)
        undo.pop_all()


def _restore(backup: Path, folder: Path, progress: Progress) -> Restored:
    found = _unpack(backup, folder, progress)
    whole = _manifest(folder / MANIFEST)
    manifest, lacks = whole["files"], whole["missing"]
    for name, facts in manifest.items():
        if found.get(name) != facts:
            raise CorruptFile(f"the backup's {name} is not what was written")
    for name in found.keys() - manifest.keys() - {MANIFEST}:  # deleted while the backup was made
        _remove(folder, name)
    catalog = folder / CATALOG
    named = {file.path for file in named_files(catalog)}
    if lost := sorted(named - manifest.keys() - lacks.keys()):
        raise CorruptFile(f"the backup lacks {lost[0]} ({len(lost)} in all)")
    require_sound(catalog)
    if store_id_in(Layout(folder)) != store_id_of(catalog):
        raise CorruptFile("the backup's store-id is not its catalog's")
    make_folder(folder / "maps")
    progress.start("syncing", len(manifest))
    for path, _, names in os.walk(folder, topdown=False):
        for name in names:
            sync(Path(path, name))
            progress.advance()
        sync(Path(path))
    # What is in the recycle bin of an old backup would be removed before anybody can restore it.
    ClockWatch(Layout(folder).clock).distrust()
    damaged, missing = (
        tuple(f"{what} ({path})" for path, what in sorted(faults.items()))
        for faults in (whole["damaged"], lacks)
    )
    return Restored(len(named & manifest.keys()), damaged, missing)


def _remove(folder: Path, name: str) -> None:
    """Remove a file, and the folders that held nothing else."""
    path = folder / name
    path.unlink()
    while (path := path.parent) != folder and not any(path.iterdir()):
        path.rmdir()


def _unpack(backup: Path, folder: Path, progress: Progress) -> dict[str, dict[str, object]]:
    """Extract a backup into a folder; return sizes and digests by name."""
    found: dict[str, dict[str, object]] = {}
    megabytes = _Megabytes(progress, backup.stat().st_size)
    try:
        with tarfile.open(backup, "r:") as tar:
            for member in tar:
                name = member.name
                if not may_be_member(name) or not member.isreg() or member.sparse:
                    raise CorruptFile(f"{name[:200]!r} cannot be part of a backup")
                if name in found:
                    raise CorruptFile(f"the backup holds {name} twice")
                found[name] = _write(tar, member, folder / name)
                megabytes.reach(tar.offset)
    except (tarfile.TarError, ValueError, EOFError) as error:
        raise CorruptFile(f"{backup} is no backup, or cut off: {error}") from error
    megabytes.reach(backup.stat().st_size)
    return found


class _Megabytes:
    """Reports how much of a file was read."""

    def __init__(self, progress: Progress, size_bytes: int) -> None:
        self._progress, self._done = progress, 0
        progress.start("unpacking MB", size_bytes // _MB)

    def reach(self, offset: int) -> None:
        """Report the megabytes up to a place in the file."""
        if more := offset // _MB - self._done:
            self._progress.advance(more)
            self._done += more


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
        parts = {part: dict(manifest.get(part, {})) for part in ("damaged", "missing")}
        parts["files"] = files = dict(manifest["files"])
    except FileNotFoundError:
        raise CorruptFile("the backup has no manifest: it is cut off, or none") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise CorruptFile(f"the backup's manifest cannot be read: {error}") from error
    if kind != (FORMAT, FORMAT_VERSION):
        raise CorruptFile(f"the backup is a {kind}, wanted {(FORMAT, FORMAT_VERSION)}")
    if missing := {CATALOG, STORE_ID} - files.keys():
        raise CorruptFile(f"the backup's manifest lacks {min(missing)}")
    path.unlink()
    return parts
