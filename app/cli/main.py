"""The commands, and their exit status."""

import ast
import errno
import gc
import inspect
import logging
import os
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from app.cli.command import Command, Group
from app.cli.errors import CommandFailed
from app.cli.standard_streams import nowhere, prepare_streams
from app.cli.stop_signals import stop_after_cleanup
from app.demo.errors import DemoFailed
from app.process import (
    collect_garbage_of_work,
    import_nothing_from_here,
    keep_freed_memory,
    one_blas_thread,
)
from core.errors import TensorMapError
from storage.errors import with_cause

_MODULES = {
    "serve": "serve",
    "backup": "backup",
    "restore": "backup",
    "verify": "verify",
    "demo": "demo",
    "upload": "upload",
    "anchor": "anchor",
    "build": "maps",
    "merge": "merge",
    "localize": "queries",
    "where": "where",
    "loop-closure": "loop_closure",
    "signature": "queries",
    "inspect": "maps",
    "evaluate": "evaluate",
    "compare": "compare",
    "report": "report",
    "simulate": "simulate",
    "audit": "audit",
    "recycle-bin": "recycle_bin",
}
"""The module of this package with each command."""


class _Commands(Group):
    """The commands, each imported when it runs: their list imports no numerical library."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - those of the base
        super().__init__(**options)
        for name in _MODULES:
            self.add_command(typer.core.TyperCommand(name))

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401 - Click's own
        for name in _MODULES:  # not above: reading them all takes a twentieth of a command's start
            self.commands[name].help = _described(name)
        return super().list_commands(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - Click's own
        for before, word in pairwise(args):
            option, equals, text = word.partition("=")
            if not word or (equals and not text and word.startswith("--")):
                # Of an unset variable: as a path it would be the current folder.
                raise typer.BadParameter(f"what follows {(option or before)!r} is empty")
        name, command, rest = super().resolve_command(ctx, args)
        if name in _MODULES:
            command = imported(name)
            if name != "serve":  # which imports more
                collect_garbage_of_work()
        return name, command, rest

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401 - Click's own
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            if ctx.invoked_subcommand != "serve":  # whose log says so
                sys.stderr.write("tensormap: stopped\n")
            raise


def _described(name: str) -> str:
    """Return a command's docstring, from its source: importing it takes a second."""
    source = Path(__file__).with_name(f"{_MODULES[name]}.py").read_text()
    for function in ast.parse(source).body:
        if isinstance(function, ast.FunctionDef) and function.name in {_function(name), "about"}:
            return ast.get_docstring(function) or ""
    return ""


def _function(name: str) -> str:
    return name.replace("-", "_")


def imported(name: str) -> Any:  # noqa: ANN401 - Click's command, which Typer keeps private
    """Import a command, and limit the libraries that it imports to one thread."""
    found = getattr(import_module(f"app.cli.{_MODULES[name]}"), _function(name))
    one_blas_thread()
    if not isinstance(found, typer.Typer):
        function, found = found, typer.Typer(add_completion=False)
        found.command(name, cls=Command)(function)
    command = typer.main.get_command(found)
    for one in (command, *getattr(command, "commands", {}).values()):
        one.help = _unwrapped(one.help or "")
        if _names_are_cut_off(one):
            one.rich_markup_mode = None
            continue
        for parameter in one.params:  # defaults in brackets are no markup for Rich
            parameter.help = escape(getattr(parameter, "help", None) or "")
    return command


def _unwrapped(docstring: str) -> str:
    """Return each paragraph as one line: Rich keeps line breaks and wraps the lines again."""
    paragraphs = inspect.cleandoc(docstring).split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


_NARROWEST = 46  # columns, below which Typer cuts names of ten characters too


def _names_are_cut_off(command: Any) -> bool:  # noqa: ANN401 - as above
    """Return whether names of options would not fit into the columns that Typer has for them.

    Then the help is a plain list, as of the programs of a system.
    """
    longest = [
        max(
            (len(name) for parameter in command.params for name in getattr(parameter, of)),
            default=0,
        )
        for of in ("opts", "secondary_opts")
    ]
    return max(4 * sum(longest), _NARROWEST) > Console().width


cli = typer.Typer(
    name="tensormap",
    cls=_Commands,
    help="Build and serve LiDAR topological maps, and localize scans in them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _show_version(requested: bool) -> None:
    if requested:
        from app.release import release  # here: it takes longer than the list of commands

        typer.echo(f"tensormap {release()}")
        raise typer.Exit


@cli.callback()
def about(
    _version: Annotated[
        bool,
        typer.Option("--version", help="Show the release.", is_eager=True, callback=_show_version),
    ] = False,
) -> None:
    """Build and serve LiDAR topological maps, and localize scans in them."""


def main() -> None:
    """Run a command; an expected error is one line, not a traceback."""
    try:
        prepare_streams()
        if sys.flags.optimize > 1:
            raise CommandFailed(_WITHOUT_DOCSTRINGS)
        import_nothing_from_here()
        # Imports make many objects that stay: looking for cycles among them takes a fifth of a
        # start. It is on again before a command works.
        gc.disable()
        if sys.argv[1:2] != ["serve"]:
            keep_freed_memory()
            stop_after_cleanup()
        try:
            cli()
        finally:
            sys.stdout.flush()  # or Python does, whose error is a traceback and status 120
    except KeyboardInterrupt:
        sys.exit(130)
    except (TensorMapError, DemoFailed, CommandFailed) as error:
        _write_error(with_cause(error))
        sys.exit(1)
    except OSError as error:
        name = error.filename2 or error.filename  # of a rename the name that was asked for
        if name is None and error.errno in _OF_OUTPUT:
            name = "standard output"
            sys.stdout = nowhere()  # what it still holds cannot be written either
        if name is None and error.errno == errno.ENOENT and _here_is_gone():
            name = "the current folder"
        if name is None:
            raise
        if error.errno != errno.EPIPE:  # as of `| head`, which has what it wanted
            _write_error(f"{name}: {error.strerror}")
        sys.exit(1)


def _write_error(text: str) -> None:
    """Write an error as one line, of the service as the lines of its log are."""
    chosen = {name.upper(): value for name, value in os.environ.items()}  # as settings are read
    if sys.argv[1:2] != ["serve"] or chosen.get("TENSORMAP_LOG_FORMAT") != "json":
        sys.stderr.write(f"tensormap: {text}\n")
        return
    # Here: other commands need no log, and the settings that are wrong may be those of the log.
    from app.http.logs import configure_logging
    from app.settings import LogFormat

    configure_logging(LogFormat.JSON)
    logging.getLogger("tensormap").error("%s", text)


def _here_is_gone() -> bool:
    """Return whether the current folder was removed, which errors do not name."""
    try:
        Path.cwd()
    except FileNotFoundError:
        return True
    return False


_WITHOUT_DOCSTRINGS = (
    "Python's option -OO, or PYTHONOPTIMIZE=2, removes the docstrings, which the help and the API"
    " show: use -O at most"
)
_OF_OUTPUT = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EPIPE, errno.EBADF}
"""Errors without a file that are of standard output: those of files are named by `storage`."""
