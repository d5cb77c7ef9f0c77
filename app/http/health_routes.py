"""Is it up, can it answer, which release is it, what does an error mean."""

from importlib.metadata import version
from typing import Annotated, Literal

from fastapi import Path, Response, status
from fastapi.responses import RedirectResponse
from pydantic import BaseModel

from app.http.errors import STATUS, NoSuchRoute
from app.http.pooled_route import pooled_router
from app.http.problems import problem_name, problems
from app.service import Running
from core.errors import TensorMapError

router = pooled_router(tags=["health"])

ProblemName = Annotated[str, Path(description="The last part of its type.")]


class Live(BaseModel):
    """The process answers."""

    status: Literal["live"] = "live"


class Ready(BaseModel):
    """Whether the service can do its work, and what is missing."""

    ready: bool
    missing: list[str]


class Version(BaseModel):
    """Which release this is."""

    name: str
    version: str


class ProblemPage(BaseModel):
    """What an error means."""

    type: str
    title: str
    status: int


@router.get("/", include_in_schema=False)
def home() -> RedirectResponse:
    """Lead a person to the documentation."""
    return RedirectResponse("/docs")


@router.get("/livez")
async def livez() -> Live:
    """Tell that the process answers."""
    # On the event loop: a server whose threads are all busy is busy, not dead.
    return Live()


@router.get("/readyz", responses={503: {"model": Ready}})
def readyz(running: Running, response: Response) -> Ready:
    """Tell whether maps can be read and written."""
    missing = []
    try:
        running.store.maps.list(limit=1)
    except TensorMapError as error:
        missing.append(f"the catalog cannot be read: {error}")
    missing += running.store.lacking()
    if not running.runner.alive:
        missing.append("builds do not run")
    if missing:
        response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return Ready(ready=not missing, missing=missing)


@router.get("/version")
def tell_version() -> Version:
    """Tell which release this is."""
    return Version(name="tensormap-server", version=version("tensormap-server"))


@router.get("/problems/{name}", responses=problems(NoSuchRoute))
def explain_problem(name: ProblemName) -> ProblemPage:
    """Explain the `type` of a problem."""
    for kind, http_status in STATUS.items():
        if problem_name(kind) == name:
            title = (kind.__doc__ or "").strip().splitlines()[0]
            return ProblemPage(type=f"/problems/{name}", title=title, status=http_status.value)
    raise NoSuchRoute(f"there is no problem {name[:80]!r}")
