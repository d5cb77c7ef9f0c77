"""The audit log: who changed what and when, and the outcome."""

from datetime import datetime
from typing import Annotated

from fastapi import Query
from pydantic import Field

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.http.errors import READING, InvalidRequest
from app.http.exact_types import Moment
from app.http.pages import Limit, PageOut, page_out
from app.http.problems import problems
from app.http.shown import Shown
from app.service import Running
from storage.catalog import AuditRecord

router = api_router(tags=["access"], dependencies=(needs(Scope.ADMIN),))

AfterEntry = Annotated[
    int,
    Query(
        alias="after", ge=0, lt=2**63, description="`next_after` of the page before, or an entry."
    ),
]
OfMap = Annotated[
    str | None, Query(alias="map", max_length=64, description="Only entries about this map.")
]
OfKey = Annotated[
    str | None, Query(alias="key", max_length=32, description="Only entries of this key.")
]
Since = Annotated[Moment | None, Query(description="Only entries of this time or later.")]
Until = Annotated[Moment | None, Query(description="Only entries before this time.")]


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
    after: AfterEntry = 0,
    limit: Limit = 100,
    map_slug: OfMap = None,
    key_id: OfKey = None,
    since: Since = None,
    until: Until = None,
) -> PageOut[AuditEntryOut]:
    """List the requested changes, oldest first, with the key of each and its outcome.

    `tensormap audit verify` detects whether an entry was changed or removed.
    """
    page = running.store.audit.list(
        after, limit, map_slug=map_slug, key_id=key_id, since=since, until=until
    )
    return page_out(page, AuditEntryOut.from_record)
