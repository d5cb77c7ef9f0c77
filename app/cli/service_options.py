"""Options of commands that talk to a service."""

from pathlib import Path
from typing import Annotated

import typer

ServiceUrl = Annotated[
    str,
    typer.Argument(metavar="URL", help="URL of the service, for example http://127.0.0.1:8000."),
]
KeyFile = Annotated[Path | None, typer.Option(metavar="FILE", help="A file with the key to send.")]


def read_key(path: Path | None) -> str | None:
    """Return the key in a file, `None` without one."""
    return None if path is None else path.read_text("ascii", "replace").strip()
