"""Health checks, the release, metrics, and what each problem means."""

from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Path, Response, status
from fastapi.responses import RedirectResponse
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import BaseModel

from app.access.dependency import require_access
from app.access.scopes import Scope, needs
from app.http.errors import KEY, STATUS, InternalError, NoSuchRoute
from app.http.pooled_route import PooledRoute, any_query
from app.http.problems import problem_name, problem_title, problems
from app.release import DISTRIBUTION, release
from app.service import Running

router = APIRouter(route_class=PooledRoute, tags=["health"])


class Live(BaseModel):
    """The process answers."""

    status: Literal["live"] = "live"


class Ready(BaseModel):
    """Whether the service works, and what is missing."""

    ready: bool
    missing: list[str]


class Version(BaseModel):
    """The release of the service."""

    name: str
    version: str


class ProblemPage(BaseModel):
    """The meaning of an error."""

    type: str
    title: str
    status: int


@router.get("/", include_in_schema=False)
@any_query
def home() -> RedirectResponse:
    """Redirect to the documentation."""
    return RedirectResponse("/docs")


@router.get("/livez")
@any_query
async def livez() -> Live:
    """Return whether the process answers."""
    # On the event loop: a server whose threads are all busy is alive.
    return Live()


@router.get("/readyz", responses={503: {"model": Ready}})
@any_query
def readyz(running: Running, response: Response) -> Ready:
    """Return whether maps can be read and written."""
    missing = running.readiness.lacking()
    if missing:
        response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return Ready(ready=not missing, missing=missing)


@router.get("/version")
def get_version() -> Version:
    """Return the release of the service."""
    return Version(name=DISTRIBUTION, version=release())


@router.get("/problems/{name}", responses=problems(NoSuchRoute))
def explain_problem(
    name: Annotated[str, Path(description="The last part of its type.")],
) -> ProblemPage:
    """Explain the `type` of a problem."""
    for kind, http_status in STATUS.items():
        if problem_name(kind) == name:
            return ProblemPage(
                type=f"/problems/{name}", title=problem_title(kind), status=http_status
            )
    raise NoSuchRoute(f"there is no problem {name[:80]!r}")


@router.get(
    "/metrics",
    response_class=Response,
    dependencies=[Depends(require_access), needs(Scope.METRICS)],
    responses={
        200: {
            "description": "Prometheus' text format.",
            "content": {CONTENT_TYPE_LATEST.partition(";")[0]: {"schema": {"type": "string"}}},
        },
        **problems(*KEY, InternalError),
    },
)
@any_query
def metrics(running: Running) -> Response:
    """Return the metrics of the service for Prometheus; if there are keys, `metrics` is needed."""
    text = running.metrics.render(running.store, len(running.tracks))
    return Response(text, media_type=CONTENT_TYPE_LATEST)
