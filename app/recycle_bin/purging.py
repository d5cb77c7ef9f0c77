"""Removal for good, of what is deleted by a request."""

from typing import Annotated

from fastapi import Query

from app.access.caller import Caller
from app.access.scopes import Scope
from app.access.trail import note
from app.http.exact_types import QueryFlag

Purge = Annotated[
    QueryFlag | None,
    Query(description="Remove it for good, not to the recycle bin; this needs scope `admin`."),
]


def require_purge(caller: Caller, *, purge: bool | None) -> None:
    """Require `admin` of who purges, and note it for the audit log.

    Raises:
        ScopeMissing: If the key does not allow it.
    """
    if purge:
        caller.require([Scope.ADMIN])
        note("purge")
