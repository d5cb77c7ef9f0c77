"""The commands, and how each one ends."""

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from app.cli import (
    audit,
    backup,
    compare,
    demo,
    evaluate,
    loop_closure,
    maps,
    merge,
    report,
    serve,
    simulate,
)
from app.demo.errors import DemoFailed
from app.threads import one_blas_thread
from core.errors import TensorMapError

__all__ = ["cli", "main"]

cli = typer.Typer(
    name="tensormap",
    help="LiDAR topological maps: build them, serve them, ask them where you are.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (
    serve.serve,
    backup.backup,
    backup.restore,
    demo.demo,
    maps.build,
    merge.merge,
    maps.localize,
    loop_closure.loop_closure,
    maps.signature,
    maps.inspect,
    evaluate.evaluate,
    compare.compare,
    report.report,
    simulate.simulate,
):
    cli.command()(command)
cli.add_typer(audit.audit, name="audit")


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
