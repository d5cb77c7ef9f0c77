"""The HTTP API: a route parses, loads, asks, answers."""

from fastapi import APIRouter, Depends

from app.access import audit_routes, key_routes
from app.access.dependency import require_access
from app.builds import job_routes
from app.builds import routes as builds
from app.drives import pose_routes, upload_routes
from app.drives import routes as drives
from app.http import health_routes, metrics_routes
from app.http.errors import KEY
from app.http.problems import problems
from app.localization import routes as localizations
from app.loop_closures import routes as loop_closures
from app.maps import routes as maps
from app.revisions import comparison_routes
from app.revisions import routes as revisions
from app.tracking import routes as tracks
from app.tracking import stream_routes


def api() -> APIRouter:
    """Return every route under /v1, all behind the key; each declares the scope that it needs."""
    router = APIRouter(
        prefix="/v1",
        dependencies=[Depends(require_access)],
        responses=problems(*KEY),
    )
    for module in (
        maps,
        drives,
        upload_routes,
        pose_routes,
        builds,
        job_routes,
        revisions,
        comparison_routes,
        localizations,
        loop_closures,
        tracks,
        key_routes,
        audit_routes,
    ):
        router.include_router(module.router)
    return router


def streams() -> APIRouter:
    """Return every stream under /v1.

    FastAPI's dependencies for keys are of requests: a stream checks its caller by itself, before
    it is accepted.
    """
    router = APIRouter(prefix="/v1")
    router.include_router(stream_routes.router)
    return router


def open_routes() -> APIRouter:
    """Return the routes beside the API: who is well needs no key to say so, metrics do."""
    router = APIRouter()
    for module in (health_routes, metrics_routes):
        router.include_router(module.router)
    return router
