"""Files that commands write: checked before long work, complete before they have their names."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import typer

from storage.files.files import named_disk_errors, publish
from storage.formats.drives.topics import without_topic

_STREAMS = frozenset({Path("/dev"), Path("/dev/fd"), Path("/proc/self/fd")})


def is_stream(path: Path) -> bool:
    """Return whether a path is a device or pipe, as `/dev/null` or a shell's `>(...)`.

    It is written as it is: a file that is complete before it has its name would replace it.
    """
    special = path.exists() and not (path.is_file() or path.is_dir())
    return special or path.absolute().parent in _STREAMS  # of a file, where a shell redirects to it


def require_folder(path: Path) -> None:
    """Check, before long work, that its result can be written as a file.

    Raises:
        typer.BadParameter: If the folder of `path` is not there or cannot be written, or `path` is
            one itself, or a device or pipe.
        OSError: If there can be no such path, as its name is too long.
    """
    with suppress(FileNotFoundError, NotADirectoryError):
        path.lstat()  # from Python 3.14 on `exists` and its kin pass over all errors
    if is_stream(path):
        raise typer.BadParameter(f"{path} is a device or pipe, wanted a file to write")
    if path.is_dir():
        raise typer.BadParameter(f"{path} is a folder, wanted a file to write")
    if not path.absolute().parent.is_dir():
        raise typer.BadParameter(f"{path} cannot be written: there is no folder {path.parent}")
    require_writable(path.parent)


def require_writable(folder: Path) -> None:
    """Check, before long work, that a folder can be written, or made in the nearest one above it.

    Raises:
        typer.BadParameter: If that cannot be written, or is a file.
    """
    nearest = next(above for above in (folder, *folder.absolute().parents) if above.exists())
    if not nearest.is_dir():
        raise typer.BadParameter(f"{nearest} is a file, wanted a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise typer.BadParameter(f"folder {nearest} cannot be written")


def require_new_file(path: Path, force: bool) -> None:
    """Check, before long work, that its result can be written and replaces no file.

    Raises:
        typer.BadParameter: As of `require_folder`, and if `path` is there without `--force`.
    """
    require_folder(path)
    if not force and os.path.lexists(path):
        raise _is_there(path)


def _is_there(path: Path) -> typer.BadParameter:
    return typer.BadParameter(f"{path} is there already; --force replaces it")


def require_file_or_stream(path: Path) -> None:
    """Check the same of a result that a device or pipe takes too.

    Raises:
        typer.BadParameter: As of `require_folder`.
    """
    if not is_stream(path):
        require_folder(path)


def require_apart(path: Path, *others: Path | None) -> None:
    """Check, before any work, that a result replaces nothing else that its command reads or writes.

    Args:
        path: The result.
        others: The other files; of a bag also with a topic, and `None` where none is given.

    Raises:
        typer.BadParameter: If `path` is one of them, by whatever name.
    """
    if is_stream(path):
        return
    for other in others:
        if other is not None and any(
            _is_same(path, name) for name in (other, without_topic(other))
        ):
            also = "it" if path == other else f"it as {other}"
            raise typer.BadParameter(
                f"{path} cannot be replaced, the command also reads or writes {also}: wanted"
                " another file"
            )


def _is_same(path: Path, other: Path) -> bool:
    with suppress(OSError):
        return path.samefile(other)
    return os.path.realpath(path) == os.path.realpath(other)  # where nothing is there yet


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Yield a path to write: of a file one that replaces it at the end, of a stream its own.

    Raises:
        StorageError: If the disk is full, read-only or failing; a subclass says which.
    """
    if is_stream(path):
        with named_disk_errors(str(path)):
            yield path
        return
    with publish(path, where=_folder_of(path)) as part:
        yield part


@contextmanager
def written_new(path: Path, force: bool) -> Iterator[Path]:
    """Yield a path to write, which is renamed at the end; it replaces no file without `--force`.

    Raises:
        typer.BadParameter: If `path` is there meanwhile, as by another command.
        StorageError: If the disk is full, read-only or failing; a subclass says which.
    """
    try:
        with publish(path, replaces=force, where=_folder_of(path)) as part:
            yield part
    except FileExistsError:
        raise _is_there(path) from None


def _folder_of(path: Path) -> str:
    return f"the folder of {path}"
