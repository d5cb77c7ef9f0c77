"""The commands, and how each one ends."""

import sys

import typer

from app.cli import demo, evaluate, maps, serve
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
    demo.demo,
    maps.build,
    maps.localize,
    maps.signature,
    maps.inspect,
    evaluate.evaluate,
):
    cli.command()(command)


def main() -> None:
    """Run a command; an error that was foreseen is one line, not a traceback."""
    one_blas_thread()
    try:
        cli()
    except TensorMapError as error:
        sys.stderr.write(f"tensormap: {error}\n")
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        sys.stderr.write(f"tensormap: {error.filename}: {error.strerror}\n")
        sys.exit(1)
