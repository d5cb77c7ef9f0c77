"""Checks of proposed loop closures."""

from app.access.scopes import Scope, needs
from app.http.bodies.bodies import Json
from app.http.errors import JSON_BODY, READING
from app.http.pooled_route import heavy, pooled_router
from app.http.problems import problems
from app.loop_closures.closures import check_closures
from app.loop_closures.schemas import LoopClosureOut, LoopClosuresIn, LoopClosuresOut
from app.service import MapSlug, Running
from core.errors import InvalidScan, InvalidSignature, StaleSignature, UnknownSegment
from storage import errors as stored

router = pooled_router(tags=["loop closures"])


@router.post(
    "/maps/{map}/loop-closures",
    dependencies=[needs(Scope.LOCALIZE)],
    responses=problems(
        stored.MapNotFound,
        stored.DriveNotFound,
        stored.ScanNotFound,
        stored.ReturnsGone,
        stored.NoLiveRevision,
        StaleSignature,
        UnknownSegment,
        InvalidSignature,
        InvalidScan,
        stored.CorruptFile,
        *JSON_BODY,
        *READING,
    ),
)
@heavy
def check_loop_closures(
    map_slug: MapSlug, body: Json[LoopClosuresIn], running: Running
) -> LoopClosuresOut:
    """Check proposed closures before they are used to correct a map.

    Two stored scans are compared by their returns in every heading: reliable, and independent of
    the map's encoding. A scan of which only signatures came is compared by these, which is far less
    reliable.
    """
    found = check_closures(running.store, running.revisions, map_slug, body)
    return LoopClosuresOut(
        closures=[LoopClosureOut.from_core(closure, body.accept_from) for closure in found]
    )
