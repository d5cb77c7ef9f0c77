"""`tensormap audit`: checks of the audit log."""

from typing import Annotated

import typer

from app.cli.chosen_settings import chosen_settings
from app.cli.command import Command, Group
from app.cli.opened_store import opened_store
from app.cli.options import DataOption
from core.errors import InvalidParameters
from storage.catalog import AuditState

audit = typer.Typer(
    name="audit",
    help="Check the log of changes.",
    cls=Group,
    no_args_is_help=True,
    add_completion=False,
)


@audit.callback()
def about() -> None:
    """Check the log of changes."""


@audit.command(cls=Command)
def verify(
    data: DataOption = None,
    known: Annotated[
        str | None,
        typer.Option(
            metavar="ENTRY:HASH",
            help="The digest that an earlier check printed: the log must begin with it.",
        ),
    ] = None,
) -> None:
    """Recompute the chain of hashes, print its last valid entry, and fail if that is not the end.

    The service may run meanwhile. Keep the output in another place: whoever can write the database
    could rewrite the whole log, and only that output would show it.
    """
    with opened_store(chosen_settings(data_dir=data)) as store:
        found = store.audit.verify(None if known is None else _state(known))
    state = f"{found.state.seq}:{found.state.hash}"
    if found.fault is not None:
        typer.echo(f"tensormap: the audit log is broken: {found.fault}; good is {state}", err=True)
        raise typer.Exit(1)
    typer.echo(state)


def _state(text: str) -> AuditState:
    entry, _, digest = text.partition(":")
    if not entry.isdecimal():
        raise InvalidParameters(f"--known is {text[:80]!r}, wanted ENTRY:HASH")
    return AuditState(int(entry), digest)
