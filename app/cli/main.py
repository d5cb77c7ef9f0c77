"""The commands, and how each one ends."""

import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from rich.markup import escape

from app.demo.errors import DemoFailed
from app.process import keep_freed_memory, one_blas_thread
from core.errors import TensorMapError

__all__ = ["cli", "imported", "main"]

_COMMANDS = {
    "serve": ("serve", "Start the service; `TENSORMAP_*` variables hold what no option sets."),
    "backup": (
        "backup",
        "Back up a data directory into one file, while the service runs; every digest is checked.",
    ),
    "restore": (
        "backup",
        "Make a new data directory of a backup; the service is then started on it.",
    ),
    "verify": (
        "verify",
        "Check every stored file against its digest, and list what is damaged, missing or left"
        " over.",
    ),
    "demo": (
        "demo",
        "Record a drive, post it, build the map, localize what was held out, and print a table.",
    ),
    "build": ("maps", "Build a map of one or more recorded drives."),
    "merge": (
        "merge",
        "Merge maps of one encoding and basis, drive after drive; no number of them changes.",
    ),
    "localize": (
        "maps",
        "Localize scans in a map; one that cannot be used is told, the others are answered.",
    ),
    "loop-closure": (
        "loop_closure",
        "Judge proposed loop closures by the returns of both scans.",
    ),
    "signature": ("maps", "Print a scan's signatures as JSON, ready to post."),
    "inspect": ("maps", "Show what a map holds; its digest is checked."),
    "evaluate": (
        "evaluate",
        "Build a map of one part of a drive and ask it where the other part was.",
    ),
    "compare": (
        "compare",
        "Run other methods of place recognition on the same scans, beside ours.",
    ),
    "report": ("report", "Redraw the paper's figures for a drive, and recommend {r1, r2, k}."),
    "simulate": (
        "simulate",
        "Drive through a simulated city and write the scans in KITTI odometry layout.",
    ),
    "audit": ("audit", "Check the log of changes."),
}
"""The module of this package that defines each command, and the first sentence of its help."""


class _Commands(typer.core.TyperGroup):
    """The commands, each imported when it runs: a list of them takes no numerical library."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - those of the base
        super().__init__(**options)
        for name, (_, text) in _COMMANDS.items():
            self.add_command(typer.core.TyperCommand(name, help=text))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - Click's own
        name, command, rest = super().resolve_command(ctx, args)
        return name, imported(name) if name in _COMMANDS else command, rest


def imported(name: str) -> Any:  # noqa: ANN401 - Click's command, which Typer keeps private
    """Import a command, and keep the libraries that came with it to one thread."""
    found = getattr(import_module(f"app.cli.{_COMMANDS[name][0]}"), name.replace("-", "_"))
    one_blas_thread()
    if not isinstance(found, typer.Typer):
        function, found = found, typer.Typer(add_completion=False)
        found.command(name)(function)
    command = typer.main.get_command(found)
    for one in (command, *getattr(command, "commands", {}).values()):
        for parameter in one.params:  # defaults in brackets are no markup of Rich's
            parameter.help = escape(getattr(parameter, "help", None) or "")
    return command


cli = typer.Typer(
    name="tensormap",
    cls=_Commands,
    help="LiDAR topological maps: build them, serve them, ask them where you are.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # here: it takes longer than the list of commands

        typer.echo(f"tensormap {version('tensormap-server')}")
        raise typer.Exit


@cli.callback()
def about(
    _version: Annotated[
        bool,
        typer.Option("--version", help="Tell the release.", is_eager=True, callback=_show_version),
    ] = False,
) -> None:
    """LiDAR topological maps: build them, serve them, ask them where you are."""


def main() -> None:
    """Run a command; an error that was foreseen is one line, not a traceback."""
    if sys.argv[1:2] != ["serve"]:
        keep_freed_memory()
    try:
        cli()
    except (TensorMapError, DemoFailed) as error:
        sys.stderr.write(f"tensormap: {error}\n")
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        sys.stderr.write(f"tensormap: {error.filename}: {error.strerror}\n")
        sys.exit(1)
