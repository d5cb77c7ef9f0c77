"""`tensormap backup` and `tensormap restore`: all of a service in one file, and back."""

import tarfile
from pathlib import Path
from typing import Annotated

import typer

from app.cli.chosen_settings import chosen_settings
from app.cli.console import progress_bar, say
from app.cli.opened_store import require_catalog
from app.cli.options import DataOption
from app.cli.output_files import require_folder
from app.process import private_files
from core.errors import InvalidParameters
from core.text import count_of
from storage.backup.backup import Backup, file_of, incomplete_of, store_of, write_backup
from storage.backup.member_names import may_be_member
from storage.backup.restore import Restored, restore_backup
from storage.store.identity import store_id_in
from storage.store.layout import Layout

_ELSEWHERE = (
    "TENSORMAP_CATALOG_URL is set: the catalog is not in the data directory. Dump it with the"
    " database's own tool (pg_dump), then copy the folder: docs/how-to/deploy.md"
)


def backup(
    output_file: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE.tar",
            help="The backup to write; an earlier one of this data directory is replaced, another"
            " file is not.",
        ),
    ],
    data: DataOption = None,
) -> None:
    """Back up a data directory into one file, while the service runs; every digest is checked.

    Damaged files are in it as they are, missing and unreadable ones are not: both are reported, the
    exit status is then 1, and the rest is a backup. Such an incomplete one never replaces an
    existing file: it is written beside it, as FILE.incomplete.tar.
    """
    settings = chosen_settings(data_dir=data)
    if settings.catalog_url is not None:
        raise InvalidParameters(_ELSEWHERE)
    output_file = file_of(output_file)
    require_folder(output_file)
    _require_replaceable(output_file, Layout(settings.data_dir.resolve()))
    require_catalog(settings.data_dir, None)
    _require_same_store(output_file, Layout(settings.data_dir))
    private_files()
    with progress_bar() as progress:
        written = write_backup(settings.data_dir, output_file, progress)
    say(f"{written.path}: {count_of(written.files, 'file')}, {written.size_bytes} bytes")
    if written.path != output_file:
        typer.echo(
            f"tensormap: this backup is incomplete: it is in {written.path}, and {output_file} is"
            " unchanged",
            err=True,
        )
    _require_whole(written)


def restore(
    backup_file: Annotated[Path, typer.Argument(help="A backup.", metavar="FILE.tar")],
    data: Annotated[
        Path, typer.Option(metavar="NEWDIR", help="The data directory: a new or empty folder.")
    ],
) -> None:
    """Create a new data directory from a backup; then start the service on it.

    Keys that were revoked after the backup are valid again. Nothing is removed for its age until
    the service has run for a day. Missing files are reported, with exit status 1; the service can
    then serve the rest.
    """
    private_files()
    with progress_bar() as progress:
        restored = restore_backup(backup_file, data, progress)
    say(f"{data}: {count_of(restored.files, 'file')}")
    _require_whole(restored)


def _require_replaceable(output_file: Path, layout: Layout) -> None:
    """Check that a backup does not replace what it is made of, or a file that is none.

    Raises:
        typer.BadParameter: If it would; in the data directory other names are free.
    """
    place = output_file.parent.resolve() / output_file.name
    named = set(vars(layout).values()) - {layout.data_dir}
    own = named | {path.resolve() for path in named}  # maps may be a link to another disk
    of_sqlite = str(place).startswith(f"{layout.catalog}-")  # as its write-ahead log
    if of_sqlite or any(place.is_relative_to(path) for path in own):
        raise typer.BadParameter(
            f"{output_file} belongs to the data directory, wanted another file for its backup"
        )
    for path in _replaced_by(output_file):
        if not _is_backup(path):
            raise typer.BadParameter(
                f"{path} is there already and is no backup, wanted a new file or an earlier"
                " backup, which is replaced"
            )


def _require_same_store(output_file: Path, layout: Layout) -> None:
    """Check that a backup replaces none of another data directory, as of one that was lost.

    A service whose disk is not mounted begins a new one, and its backup would be empty.

    Raises:
        typer.BadParameter: If it would.
    """
    own = store_id_in(layout)
    if own is None:
        return  # the backup reports that
    for path in _replaced_by(output_file):
        if (store := store_of(path)) not in {None, own}:
            raise typer.BadParameter(
                f"{path} is there already and is a backup of another data directory, of store"
                f" {store}: wanted another name, or that you move it away"
            )


def _replaced_by(output_file: Path) -> list[Path]:
    """Return the files with a content that a backup may replace, whole or incomplete."""
    if not output_file.exists():
        return []
    paths = output_file, incomplete_of(output_file)
    return [path for path in paths if path.exists() and path.stat().st_size]


def _is_backup(path: Path) -> bool:
    try:
        with tarfile.open(path, "r:") as tar:
            first = tar.next()
    except (tarfile.TarError, IsADirectoryError):
        return False
    return first is not None and may_be_member(first.name)


def _require_whole(made: Backup | Restored) -> None:
    """Report damaged and missing files, and fail if there are any."""
    for file in made.damaged:
        typer.echo(f"tensormap: damaged before the backup, and as it is in it: {file}", err=True)
    for file in made.missing:
        typer.echo(f"tensormap: the backup lacks what its catalog names: {file}", err=True)
    if made.damaged or made.missing:
        raise typer.Exit(1)
