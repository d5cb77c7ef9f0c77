"""Files of killed processes and orphans: found, and removed or moved to `orphans/`."""

import errno
import logging
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from storage.catalog import Catalog
from storage.errors import StorageError, with_cause
from storage.files.claims import remove_abandoned
from storage.files.files import discard, entries, make_folder, sync
from storage.names import new_id
from storage.store.clock import ClockWatch
from storage.store.layout import CATALOG, Layout

ORPHANS_KEPT_DAYS = 30
"""As long as revisions are retained by default: enough time to notice that one is missing."""

_HALF_WRITTEN = "half-written"
_PART = re.compile(r"\..*\.part")  # what `publish` writes to
_DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
_IN_USE_S = 86_400.0  # a build writes for hours, and its file changes continuously

_log = logging.getLogger("tensormap.storage")


@dataclass(frozen=True)
class Leftover:
    """Something in the data directory that no row names.

    Attributes:
        path: The leftover's path.
        what: A description.
        useless: Whether it can be removed; else it may be the only copy of something.
        done: What a sweep did; empty before.
    """

    path: Path
    what: str
    useless: bool
    done: str = ""


def leftovers(catalog: Catalog, layout: Layout, *, alone: bool) -> list[Leftover]:
    """Return the leftovers.

    Args:
        catalog: Names the files.
        layout: Locates them.
        alone: Whether no server runs; else files younger than a day may be in use, and are left
            out.
    """
    found = [
        *(Leftover(path, _HALF_WRITTEN, useless=True) for path in _half_written(layout)),
        *(Leftover(path, "no row names it", useless=False) for path in _unnamed(catalog, layout)),
        *(
            Leftover(path, "of no capture that is uploaded", useless=True)
            for path in _unnamed_captures(catalog, layout)
        ),
    ]
    kept = [item for item in found if alone or _age_s(item.path) > _IN_USE_S]
    # Half-written files first: else they are moved with their folder, and kept.
    return sorted(kept, key=lambda item: (not item.useless, item.what != _HALF_WRITTEN, item.path))


def sweep(catalog: Catalog, layout: Layout, clock: ClockWatch) -> list[Leftover]:
    """Remove half-written files, and move what no row names to `orphans/`; return what was done.

    Parts of captures that no row names are removed, too, and folders without a file.

    Usually a crash left it. Should the catalog be wrong, as after a partial restore, nothing is
    lost: it stays there under the day and its former path, for `ORPHANS_KEPT_DAYS`.

    Only safe while no other process writes: a file is written before its row.
    """
    swept = []
    orphans = 0
    for item in leftovers(catalog, layout, alone=True):
        remove = remove_abandoned if item.useless else _remove_empty
        if remove(item.path):
            done = "removed"
        elif not item.useless:
            done = "left: it cannot be moved"
            with _logged(item.path, layout.orphans):
                set_aside(item.path, layout, layout.orphans)
                orphans += 1
                done = "moved to orphans/"
        else:
            done = "left: it is in use, or is not this user's"
        swept.append(replace(item, done=done))
    if orphans:
        _log.warning(
            "%d files or folders that the catalog does not name were moved to %s",
            orphans,
            layout.orphans,
        )
    _expire(layout, clock)
    return swept


def set_aside(path: Path, layout: Layout, folder: Path) -> Path:
    """Move a file or folder to `folder`, under today's date and its former path."""
    aside = folder / _today().isoformat() / path.relative_to(layout.data_dir)
    make_folder(aside.parent)
    aside = _free(aside)
    _move(path, aside)
    return aside


def _free(path: Path) -> Path:
    """Return a path, or one beside it where that is taken."""
    return path.with_name(f"{path.name}.{new_id()[:8]}") if path.exists() else path


def _move(path: Path, to: Path) -> None:
    try:
        path.rename(to)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise  # a copy could be made, and what was copied not be removed
        if path.is_symlink():
            to.symlink_to(path.readlink())
        else:
            _copy_durably(path, to)
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _copy_durably(path: Path, to: Path) -> None:
    """Copy a file or folder to another disk, whole and synced, or not at all."""
    try:
        if path.is_dir():
            shutil.copytree(path, to, symlinks=True)
        else:
            shutil.copy2(path, to)
        for folder, _, files in os.walk(to):
            for copied in (*(Path(folder, name) for name in files), Path(folder)):
                if not copied.is_symlink():  # of which the folder is all there is
                    sync(copied)
        if to.is_file():
            sync(to)
        sync(to.parent)
    except BaseException:
        shutil.rmtree(to, ignore_errors=True) if to.is_dir() else discard(to)
        raise


@contextmanager
def _logged(path: Path, folder: Path) -> Iterator[None]:
    """Log that something cannot be moved, such as another user's folder: the service starts."""
    try:
        yield
    except (StorageError, OSError) as error:
        _log.warning("%s cannot be moved to %s: %s", path, folder, with_cause(error))


def _today() -> date:
    return datetime.now(UTC).date()


def _expire(layout: Layout, clock: ClockWatch) -> None:
    """Remove the expired days of `orphans/`; files of older versions count from today.

    None is removed while the clock cannot be trusted.
    """
    last = _today() - timedelta(days=ORPHANS_KEPT_DAYS)
    expired = []
    for path in _listed(layout.orphans):
        if not _DAY.fullmatch(path.name):
            target = layout.orphans / _today().isoformat() / path.name
            with _logged(path, target.parent):
                make_folder(target.parent)
                _move(path, _free(target))
        elif path.name < last.isoformat():
            expired.append(path)
    if expired and clock.is_trusted():
        for path in expired:
            shutil.rmtree(path, ignore_errors=True)
            if not path.exists():
                _log.warning("%s was removed, after %d days", path, ORPHANS_KEPT_DAYS)


def abandoned_copies(folder: Path) -> list[Path]:
    """Return the folders with a catalog's copy that backups, also of older versions, made here.

    One may be in use: `remove_abandoned` checks that.
    """
    found = [*folder.glob(".tensormap-backup-*"), *folder.glob(".backup-????????")]
    return list(filter(_is_copy, found))


def _is_copy(folder: Path) -> bool:
    """Return whether a folder that can be read has nothing but a catalog's copy.

    A backup beside this one may end meanwhile, or be of another user.
    """
    try:
        return all(held.name.startswith(CATALOG) for held in folder.iterdir())
    except OSError:
        return False


def _half_written(layout: Layout) -> Iterator[Path]:
    for folder, folders, files in os.walk(layout.maps):  # passes over what cannot be listed
        yield from (Path(folder, name) for name in (*folders, *files) if _PART.fullmatch(name))
    for top in (layout.data_dir, layout.bases):
        yield from (path for path in _listed(top) if _PART.fullmatch(path.name))
    yield from abandoned_copies(layout.data_dir)


def _unnamed(catalog: Catalog, layout: Layout) -> Iterator[Path]:
    by_map = catalog.drives.by_map()
    revisions, chunks = catalog.revisions.files_by_map(), catalog.scans.chunks_by_drive()
    yield from _others(layout.maps, set(by_map))
    yield from _others(layout.bases, set(catalog.bases.files()))
    purged = _purged(catalog)
    for map_id, drives in by_map.items():
        if map_id in purged:
            continue
        yield from _others(layout.revisions(map_id), set(revisions.get(map_id, ())))
        yield from _others(layout.map(map_id) / "drives", drives)
        for drive_id in drives - purged:
            yield from _others(layout.chunks(map_id, drive_id), chunks.get(drive_id, set()))


def _unnamed_captures(catalog: Catalog, layout: Layout) -> Iterator[Path]:
    """Yield parts that no row names: they can be sent again, and may take as much as a map."""
    named = catalog.captures.named_files()
    for map_id in catalog.drives.by_map().keys() - _purged(catalog):
        captures = named.get(map_id, {})
        yield from _others(layout.captures(map_id), set(captures))
        for capture_id, files in captures.items():
            yield from _others(layout.capture(map_id, capture_id), set(files))


def _purged(catalog: Catalog) -> set[str]:
    """Return the ids of maps and drives whose rows are removed now, and then their files."""
    return {purge.id for purge in catalog.purges.begun()}


def _listed(folder: Path) -> list[Path]:
    """Return what a folder has; nothing if it cannot be listed: the service starts without it."""
    try:
        return entries(folder)
    except OSError as error:
        _log.warning("%s cannot be listed: what is left over in it stays: %s", folder, error)
        return []


def _others(folder: Path, names: set[str]) -> Iterator[Path]:
    for path in _listed(folder):
        if path.name not in names and not _PART.fullmatch(path.name):
            yield path


def _remove_empty(path: Path) -> bool:
    """Remove a folder that has no file, not in its folders either; return whether it did.

    Never a file, should a folder have been unreadable, or one come meanwhile.
    """
    if path.is_symlink() or not path.is_dir() or any(files for _, _, files in os.walk(path)):
        return False
    with suppress(OSError):
        for folder, _, _ in os.walk(path, topdown=False):
            Path(folder).rmdir()
    return not path.exists()


def _age_s(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except FileNotFoundError:  # it was in use
        return 0.0
