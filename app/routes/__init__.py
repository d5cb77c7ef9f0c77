"""The HTTP API: a route parses, loads, asks, answers."""

from fastapi import APIRouter, Depends

from app.access.dependency import require_access
from app.errors import (
    HostNotAllowed,
    KeyNeeded,
    KeyRefused,
    ScopeMissing,
    ServiceBusy,
    TooManyRequests,
)
from app.problems import problems
from app.routes import (
    audit,
    builds,
    comparisons,
    drives,
    health,
    jobs,
    keys,
    localizations,
    loop_closures,
    maps,
    metrics,
    poses,
    revisions,
    tokens,
    track_stream,
    tracks,
    uploads,
)

__all__ = ["api", "open_routes", "streams"]


def api() -> APIRouter:
    """Return every route under /v1, all behind the key; each declares the scope that it needs."""
    router = APIRouter(
        prefix="/v1",
        dependencies=[Depends(require_access)],
        responses=problems(
            KeyNeeded, KeyRefused, HostNotAllowed, ScopeMissing, ServiceBusy, TooManyRequests
        ),
    )
    for module in (
        maps,
        drives,
        uploads,
        poses,
        builds,
        jobs,
        revisions,
        comparisons,
        localizations,
        loop_closures,
        tracks,
        keys,
        tokens,
        audit,
    ):
        router.include_router(module.router)
    return router


def streams() -> APIRouter:
    """Return every stream under /v1.

    FastAPI's dependencies for keys are of requests: a stream checks its caller by itself, before
    it is accepted.
    """
    router = APIRouter(prefix="/v1")
    router.include_router(track_stream.router)
    return router


def open_routes() -> APIRouter:
    """Return the routes beside the API: who is well needs no key to say so, metrics do."""
    router = APIRouter()
    for module in (health, metrics):
        router.include_router(module.router)
    return router
