"""The commands, and how each one ends."""

import sys
from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any

import typer

from app.demo.errors import DemoFailed
from app.process import keep_freed_memory, one_blas_thread
from core.errors import TensorMapError

__all__ = ["cli", "main"]

_MODULES = {
    "serve": "serve",
    "backup": "backup",
    "restore": "backup",
    "verify": "verify",
    "demo": "demo",
    "build": "maps",
    "merge": "merge",
    "localize": "maps",
    "loop-closure": "loop_closure",
    "signature": "maps",
    "inspect": "maps",
    "evaluate": "evaluate",
    "compare": "compare",
    "report": "report",
    "simulate": "simulate",
    "audit": "audit",
}
"""Which module of this package has a command."""


class _Commands(typer.core.TyperGroup):
    """The commands, each imported when it is asked for: none waits for what others need."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002 - Click's own
        return list(_MODULES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401, ARG002 - the same
        if cmd_name not in _MODULES:
            return None
        if cmd_name not in self.commands:
            module = import_module(f"app.cli.{_MODULES[cmd_name]}")
            found = getattr(module, cmd_name.replace("-", "_"))
            if not isinstance(found, typer.Typer):
                function, found = found, typer.Typer(add_completion=False)
                found.command(cmd_name)(function)
            self.commands[cmd_name] = typer.main.get_command(found)
        return self.commands[cmd_name]


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
    one_blas_thread()
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
