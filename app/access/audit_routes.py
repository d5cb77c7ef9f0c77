"""The audit log: who changed what, when, and what came of it."""

from typing import Annotated

from fastapi import Query

from app.access.audit_schemas import AuditEntryOut
from app.access.scopes import Scope, needs
from app.http.errors import READING, InvalidRequest
from app.http.exact_types import Moment
from app.http.pages import Limit, PageOut, page_out
from app.http.pooled_route import pooled_router
from app.http.problems import problems
from app.service import Running

router = pooled_router(tags=["access"])

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
Since = Annotated[Moment | None, Query(description="Only entries of this moment or later.")]
Until = Annotated[Moment | None, Query(description="Only entries before this moment.")]


@router.get(
    "/audit",
    dependencies=[needs(Scope.ADMIN)],
    responses=problems(InvalidRequest, *READING),
)
def list_audit(
    running: Running,
    after: AfterEntry = 0,
    limit: Limit = 100,
    map_slug: OfMap = None,
    key_id: OfKey = None,
    since: Since = None,
    until: Until = None,
) -> PageOut[AuditEntryOut]:
    """List the changes that were asked for, oldest first, with who asked and what came of it.

    `tensormap audit verify` tells whether an entry was changed or removed.
    """
    page = running.store.audit.list(
        after, limit, map_slug=map_slug, key_id=key_id, since=since, until=until
    )
    return page_out(page, AuditEntryOut.from_record)
