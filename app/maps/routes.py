"""Maps: the named containers of drives and revisions."""

from fastapi import Response, status

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.http import errors
from app.http.answer_headers import ETAG, LOCATION, headed
from app.http.bodies.bodies import Json
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import heavy_if, light
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.maps.schemas import MapAnchorIn, MapIn, MapOut, MapPatch
from app.maps.versions import IfMatch, shown_map, versions_seen
from app.recycle_bin.purging import Purge, require_purge
from app.service import Running
from core.mapping.anchor import Anchor
from storage.catalog import Keep
from storage.errors import InvalidSlug, MapChanged, MapExists, MapNotFound

reading = api_router(tags=["maps"], dependencies=(needs(Scope.MAPS_READ),))
writing = api_router(tags=["maps"], dependencies=(needs(Scope.MAPS_WRITE),))


@writing.post(
    "/maps",
    status_code=status.HTTP_201_CREATED,
    responses={
        201: headed(LOCATION, ETAG),
        **problems(InvalidSlug, MapExists, *errors.JSON_BODY, *errors.WRITING),
    },
)
def create_map(
    sent: Json[MapIn], running: Running, response: Response, caller: CurrentCaller
) -> MapOut:
    """Create an empty map."""
    note("", map_slug=sent.map)
    caller.require_new_map(sent.map)
    record = running.store.maps.create(sent.map, sent.description)
    response.headers[LOCATION] = f"/v1/maps/{record.slug}"
    return shown_map(record, running, response)


@reading.get("/maps", responses=problems(errors.InvalidRequest, *errors.READING))
def list_maps(
    running: Running, caller: CurrentCaller, after: After = "", limit: Limit = 100
) -> PageOut[MapOut]:
    """List the maps by name, those within the limits of the key."""
    page = running.store.maps.list(after, limit, slugs=caller.maps)
    default = running.settings.retention
    return page_out(page, lambda record: MapOut.from_record(record, default))


@reading.get(
    "/maps/{map}",
    responses={
        200: headed(ETAG),
        **problems(MapNotFound, *errors.READING),
    },
)
@light
def get_map(map_slug: MapSlug, running: Running, response: Response) -> MapOut:
    """Show a map."""
    record = running.store.maps.get(map_slug)
    return shown_map(record, running, response)


@writing.patch(
    "/maps/{map}",
    responses={
        200: headed(ETAG),
        **problems(MapNotFound, MapChanged, *errors.JSON_BODY, *errors.WRITING),
    },
)
def update_map(
    map_slug: MapSlug,
    change: Json[MapPatch],
    running: Running,
    response: Response,
    if_match: IfMatch = None,
) -> MapOut:
    """Change a map's description, retention or anchor."""
    kept = None if change.retention is None else change.retention.model_dump(exclude_unset=True)
    anchor = Keep.AS_IT_IS if "anchor" not in change.model_fields_set else _anchor(change.anchor)
    changes = []
    if kept:
        changes.append("retention " + ", ".join(f"{name}={value}" for name, value in kept.items()))
    if anchor is not Keep.AS_IT_IS:
        changes.append(f"anchor {anchor}")
    note("; ".join(changes))
    record = running.store.maps.update(
        map_slug,
        description=change.description,
        retention=kept,
        anchor=anchor,
        if_versions=versions_seen(if_match),
    )
    if kept:
        running.collector.wake(map_slug)
    return shown_map(record, running, response)


@writing.delete(
    "/maps/{map}",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(MapNotFound, MapChanged, errors.InvalidRequest, *errors.WRITING),
)
@heavy_if(lambda given: given["purge"])
def delete_map(
    map_slug: MapSlug,
    running: Running,
    caller: CurrentCaller,
    if_match: IfMatch = None,
    purge: Purge = None,
) -> None:
    """Delete a map with its drives, revisions and jobs; it can be restored from the recycle bin.

    Its tracks end for good.
    """
    maps = running.store.maps
    require_purge(caller, purge=purge)
    deleted = (maps.purge if purge else maps.delete)(map_slug, if_versions=versions_seen(if_match))
    running.tracks.remove_of_map(deleted.id)
    running.collector.wake()


def _anchor(sent: MapAnchorIn | None) -> Anchor | None:
    return None if sent is None else Anchor(**sent.model_dump())
