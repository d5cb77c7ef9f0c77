"""Owner and modes of the data directory: only its owner has access."""

import logging
import os
import stat
from pathlib import Path
from tempfile import TemporaryFile

from core.errors import InvalidParameters
from storage.files.files import named_disk_errors
from storage.store.layout import Layout

_OTHERS = stat.S_IRWXG | stat.S_IRWXO

_log = logging.getLogger("tensormap.storage")


def require_owner(layout: Layout) -> None:
    """Reject root on the data directory of another user, who could not read what root writes.

    Of a folder without data yet its own owner counts. Users other than root have the rights
    that the files give them. Where the file system has no owners, or all files have the same one,
    whoever writes them, nothing is rejected.

    Raises:
        InvalidParameters: If it is so; nothing is changed.
        StorageFull: If no space is left to find out.
        StorageReadOnly: If the folder cannot be written.
    """
    owned = layout.store_id if layout.store_id.exists() else layout.data_dir
    if os.geteuid() != 0 or not owned.exists():
        return
    owner = owned.stat().st_uid
    if owner != 0 and _owner_of_a_new_file(layout.data_dir) != owner:
        raise InvalidParameters(
            f"{layout.data_dir} belongs to user {owner}, who could not read what root writes in it:"
            " start the service as that user, as with sudo -u, or give the folder to root with"
            " chown -R"
        )


def _owner_of_a_new_file(folder: Path) -> int:
    with named_disk_errors(), TemporaryFile(dir=folder) as probe:
        return os.fstat(probe.fileno()).st_uid


def make_private(layout: Layout) -> int:
    """Remove the permissions of group and others, from older versions or the operator's umask.

    The folder itself is the last: where it is private already no file is checked, so that a start
    does not visit a million files each time.

    Args:
        layout: A data directory; files that are not ours stay as they are.

    Returns:
        The number of changed modes.
    """
    if not _is_open(layout.data_dir) and not _is_open(layout.maps):
        return 0
    changed = sum(_close(path) for path in _ours(layout))
    # Each may be a link to a folder of another disk.
    changed += _close(layout.maps.resolve()) + _close(layout.data_dir.resolve())
    if changed:
        _log.info("%d files and folders of %s are now private", changed, layout.data_dir)
    return changed


def _ours(layout: Layout) -> list[Path]:
    found = [*layout.data_dir.glob(f"{layout.catalog.name}*"), layout.store_id, layout.lock]
    for top in (layout.maps, layout.bases, layout.orphans, layout.damaged):
        for folder, folders, files in os.walk(top):
            found += [Path(folder, name) for name in (*files, *folders)]
        if top != layout.maps:
            found.append(top)
    return found


def _is_open(path: Path) -> bool:
    return path.exists() and bool(path.stat().st_mode & _OTHERS)


def _close(path: Path) -> bool:
    """Remove the permissions of group and others; return whether there were any."""
    try:
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode) or not mode & _OTHERS:
            return False
        path.chmod(stat.S_IMODE(mode) & ~_OTHERS)
    except FileNotFoundError:  # SQLite's own come and go
        return False
    except OSError as error:  # another's, as a mounted volume may be
        _log.warning("%s can be read by others: %s", path, error)
        return False
    return True
