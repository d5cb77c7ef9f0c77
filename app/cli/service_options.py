"""Options of commands that talk to a service."""

from pathlib import Path
from typing import Annotated

import typer

from app.access.secrets import is_well_formed
from app.cli.errors import CommandFailed

ServiceUrl = Annotated[
    str,
    typer.Argument(metavar="URL", help="URL of the service, for example http://127.0.0.1:8000."),
]
KeyFile = Annotated[Path | None, typer.Option(metavar="FILE", help="A file with the key to send.")]


def read_key(path: Path | None) -> str | None:
    """Return the key in a file, `None` without one.

    Raises:
        CommandFailed: If the file has none, or if the key itself was given: an error that repeats
            it would put it into logs.
        OSError: If the file cannot be read.
    """
    if path is None:
        return None
    if is_well_formed(str(path)):
        raise CommandFailed("--key-file is a key itself, wanted the name of a file with the key")
    key = path.read_text("utf-8-sig", "replace").strip()  # editors of Windows write a mark
    if not (key and key.isascii() and key.isprintable()):
        got = "it is empty" if not key else "it has other characters"
        raise CommandFailed(f"{path}: {got}, wanted one key, printable ASCII in one line")
    return key
