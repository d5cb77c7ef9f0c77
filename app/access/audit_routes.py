"""The audit log: who changed what and when, and the outcome."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated

from fastapi import Query
from pydantic import Field

from app.access.actions import Action
from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.http.errors import READING, InvalidRequest
from app.http.exact_types import Moment
from app.http.pages import Limit, PageOut, page_out
from app.http.problems import problems
from app.http.shown import Shown
from app.service import Running
from storage.catalog import AuditRecord
from storage.names import SLUG_PATTERN

router = api_router(tags=["access"], dependencies=(needs(Scope.ADMIN),))

# A text, as `next_after` and the cursors of other lists are.
AfterEntry = Annotated[
    str,
    Query(
        alias="after",
        pattern="^[0-9]{0,18}$",
        description="`next_after` of the page before, or an entry: the page begins after it in"
        " `order`, whatever the filters; empty or 0 for the first page.",
    ),
]
# Of a name that no entry can have, an empty list would say that nobody changed anything.
OfMap = Annotated[
    str | None,
    Query(alias="map", pattern=SLUG_PATTERN, description="Only entries about this map."),
]
OfKey = Annotated[
    str | None,
    Query(alias="key", pattern="^[0-9a-z]{1,32}$", description="Only entries of this key, by id."),
]
OfActions = Annotated[
    list[Action] | None,
    Query(alias="action", description="Only entries with one of these actions; repeatable."),
]
Since = Annotated[Moment | None, Query(description="Only entries of this time or later.")]
Until = Annotated[Moment | None, Query(description="Only entries before this time.")]


class Order(StrEnum):
    """Which entry of a list is the first."""

    OLDEST = "oldest"
    NEWEST = "newest"


OrderOfEntries = Annotated[
    Order, Query(alias="order", description="Whether the oldest or the newest entry is the first.")
]


class AuditEntryOut(Shown):
    """A requested change and its outcome."""

    entry: int = Field(description="The entry's place in the log, counted from 1 without a gap.")
    at: datetime
    key: str = Field(
        description="Id of the key; `operator` for that of the settings, `everyone` without keys,"
        " `service` for what the service does by itself."
    )
    action: str = Field(examples=["make_live"])
    subject: str = Field(description="The path of the request.")
    map: str | None = Field(description="The map that it is about; null if about none.")
    detail: str = Field(description="Details that the path does not show.")
    outcome: str = Field(description="`done`, or the status of a rejected or failed request.")
    hash: str = Field(description="SHA-256 over all this and the hash of the entry before.")

    @classmethod
    def from_record(cls, record: AuditRecord) -> "AuditEntryOut":
        """Show an entry's record."""
        return cls.of(record, entry=record.seq, key=record.key_id, map=record.map_slug)


@router.get("/audit", responses=problems(InvalidRequest, *READING))
def list_audit(
    running: Running,
    after: AfterEntry = "",
    limit: Limit = 100,
    map_slug: OfMap = None,
    key_id: OfKey = None,
    actions: OfActions = None,
    since: Since = None,
    until: Until = None,
    order: OrderOfEntries = Order.OLDEST,
) -> PageOut[AuditEntryOut]:
    """List the requested changes, oldest or newest first, with the key of each and its outcome.

    Entries that are added meanwhile are at the end of the oldest first, and on none of the later
    pages of the newest first.

    `tensormap audit verify` detects whether an entry was changed or removed.
    """
    page = running.store.audit.list(
        int(after or 0),
        limit,
        map_slug=map_slug,
        key_id=key_id,
        actions=actions or (),
        since=since,
        until=until,
        newest_first=order is Order.NEWEST,
    )
    return page_out(page, AuditEntryOut.from_record)
