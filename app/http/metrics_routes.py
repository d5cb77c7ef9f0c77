"""Metrics for Prometheus."""

from fastapi import Depends, Response
from prometheus_client import CONTENT_TYPE_LATEST

from app.access.dependency import require_access
from app.access.scopes import Scope, needs
from app.http.errors import KEY, InternalError
from app.http.pooled_route import pooled_router
from app.http.problems import problems
from app.service import Running

router = pooled_router(tags=["health"])


@router.get(
    "/metrics",
    response_class=Response,
    dependencies=[Depends(require_access), needs(Scope.ADMIN)],
    responses={
        200: {
            "description": "Prometheus' text format.",
            "content": {CONTENT_TYPE_LATEST.partition(";")[0]: {"schema": {"type": "string"}}},
        },
        **problems(*KEY, InternalError),
    },
)
def metrics(running: Running) -> Response:
    """Tell what the service counts, in Prometheus' words; where there are keys, to `admin`."""
    text = running.metrics.render(running.store, len(running.tracks))
    return Response(text, media_type=CONTENT_TYPE_LATEST)
