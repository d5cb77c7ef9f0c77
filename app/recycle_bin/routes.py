"""The recycle bin: list, restore and purge deleted maps and drives."""

from typing import Annotated

from fastapi import Path, Query, Response, status

from app.access.api_router import api_router
from app.access.caller import Caller
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.http import errors
from app.http.answer_headers import LOCATION, headed
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.recycle_bin.schemas import RecycledOut, RestoredOut
from app.service import Running, Service
from core.errors import InvalidParameters
from storage import errors as stored
from storage.catalog import RecycledRecord

reading = api_router(tags=["recycle bin"], dependencies=(needs(Scope.MAPS_READ, Scope.MAPS_WRITE),))
writing = api_router(tags=["recycle bin"], dependencies=(needs(Scope.MAPS_WRITE),))
purging = api_router(tags=["recycle bin"], dependencies=(needs(Scope.ADMIN),))

Entry = Annotated[str, Path(alias="entry", description="`entry` of the list.")]
NewName = Annotated[
    str | None,
    Query(
        max_length=64,
        description="Another name for it; by default the one that it had, which may be taken now.",
    ),
]


@reading.get(
    "/recycle-bin",
    responses=problems(InvalidParameters, errors.InvalidRequest, *errors.READING),
)
def list_deleted(
    running: Running, caller: CurrentCaller, after: After = "", limit: Limit = 100
) -> PageOut[RecycledOut]:
    """List what was deleted and can be restored, the last one first.

    Drives of a deleted map are not listed: they are restored with it.
    """
    page = running.store.recycle_bin.list(after, limit, slugs=caller.maps)
    kept_days = running.settings.recycle_bin_days
    return page_out(page, lambda record: RecycledOut.from_record(record, kept_days))


@writing.post(
    "/recycle-bin/{entry}/restore",
    responses={
        200: headed(LOCATION),
        **problems(
            stored.NotInRecycleBin,
            stored.MapExists,
            stored.DriveExists,
            stored.InvalidSlug,
            errors.InvalidRequest,
            *errors.WRITING,
        ),
    },
)
def restore_deleted(
    entry: Entry,
    running: Running,
    caller: CurrentCaller,
    response: Response,
    name: NewName = None,
) -> RestoredOut:
    """Restore a map or drive as it was when it was deleted; cancelled builds stay cancelled."""
    found = _within_limits(entry, running, caller)
    if name is not None:
        note(f"{found} as {name}")
    if found.drive_slug is None and name is not None:
        caller.require_new_map(name)
    restored = running.store.recycle_bin.restore(entry, name)
    map_slug, drive = restored.map_slug, restored.drive_slug
    if drive is None:
        response.headers[LOCATION] = f"/v1/maps/{map_slug}"
        return RestoredOut(kind="map", map=map_slug, drive=None)
    response.headers[LOCATION] = f"/v1/maps/{map_slug}/drives/{drive}"
    return RestoredOut(kind="drive", map=map_slug, drive=drive)


@purging.delete(
    "/recycle-bin/{entry}",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(stored.NotInRecycleBin, *errors.WRITING),
)
@heavy
def purge_deleted(entry: Entry, running: Running, caller: CurrentCaller) -> None:
    """Remove a deleted map or drive for good."""
    _within_limits(entry, running, caller)
    running.store.recycle_bin.purge(entry)


def _within_limits(entry: str, running: Service, caller: Caller) -> RecycledRecord:
    """Return an entry of a map within the limits of the key, and note it for the audit log."""
    found = running.store.recycle_bin.get(entry)
    if not caller.sees(found.map_slug):
        raise stored.NotInRecycleBin(f"the recycle bin has no map or drive with id {entry[:80]!r}")
    note(str(found), map_slug=found.map_slug)
    return found
