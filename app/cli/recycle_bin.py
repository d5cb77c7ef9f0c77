"""`tensormap recycle-bin`: deleted maps and drives of a data directory, whose service may run."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Annotated
from urllib.parse import quote

import typer

from app.cli.chosen_settings import chosen_settings
from app.cli.command import Command, Group
from app.cli.console import say
from app.cli.opened_store import opened_store
from app.cli.options import DataOption
from app.http.errors import STATUS
from core.errors import TensorMapError
from storage.catalog import OPERATOR_ID, Act, on_behalf
from storage.catalog.pages import all_items
from storage.store import Store

EntryArgument = Annotated[
    str, typer.Argument(metavar="ENTRY", help="The entry's id: the first column of the list.")
]

recycle_bin = typer.Typer(
    name="recycle-bin",
    help="List, restore and purge deleted maps and drives.",
    cls=Group,
    no_args_is_help=True,
    add_completion=False,
)


@recycle_bin.callback()
def about() -> None:
    """List, restore and purge deleted maps and drives."""


@recycle_bin.command("list", cls=Command)
def list_entries(data: DataOption = None) -> None:
    """List what was deleted, the last one first: entry, name, size, and until when it is kept.

    That is by TENSORMAP_RECYCLE_BIN_DAYS as it is set here: set it as for the service.
    """
    settings = chosen_settings(data_dir=data)
    with opened_store(settings) as store:
        entries = list(all_items(store.recycle_bin.list))
        if not entries:
            typer.echo("nothing is in the recycle bin", err=True)
        for entry in entries:
            until = entry.deleted_at + timedelta(days=settings.recycle_bin_days)
            say(f"{entry.id}  {entry}, {entry.size_bytes} bytes, until {until:%Y-%m-%d %H:%M}Z")


@recycle_bin.command(cls=Command)
def restore(
    entry: EntryArgument,
    name: Annotated[
        str | None, typer.Option(metavar="NAME", help="A new name, if the old one is taken.")
    ] = None,
    data: DataOption = None,
) -> None:
    """Restore a map or drive as it was when it was deleted."""
    with (
        opened_store(chosen_settings(data_dir=data)) as store,
        _logged(store, "restore_deleted", entry, name),
    ):
        say(f"{store.recycle_bin.restore(entry, name)} is restored")


@recycle_bin.command(cls=Command)
def purge(entry: EntryArgument, data: DataOption = None) -> None:
    """Remove a deleted map or drive for good."""
    with (
        opened_store(chosen_settings(data_dir=data)) as store,
        _logged(store, "purge_deleted", entry),
    ):
        say(f"{store.recycle_bin.purge(entry)} is removed")


@contextmanager
def _logged(
    store: Store, action: str, entry_id: str, new_name: str | None = None
) -> Iterator[None]:
    """Log what the block does as done by who operates the service, or why it was refused."""
    act = Act(OPERATOR_ID, action, f"/v1/recycle-bin/{quote(entry_id[:80], safe='')}")
    try:
        entry = store.recycle_bin.get(entry_id)
        act.map_slug = entry.map_slug
        act.detail = str(entry) if new_name is None else f"{entry} as {new_name}"
        with on_behalf(act):
            yield
    except TensorMapError as error:
        status = next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)
        with suppress(TensorMapError):  # as of a full disk, which may be why it failed
            store.audit.append(act, str(status.value))
        raise
