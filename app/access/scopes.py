"""What a key allows, and how a route declares what it needs."""

from enum import StrEnum
from typing import Annotated, Any

from fastapi import Depends, Security
from fastapi.params import Security as SecurityDependency
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from app.http.direct import known

bearer_scheme = HTTPBearer(
    auto_error=False,
    description="A key of this service, or a token that was exchanged for one.",
)


class Scope(StrEnum):
    """What a key allows; none implies another, but `admin` implies all."""

    MAPS_READ = "maps:read"
    MAPS_WRITE = "maps:write"
    LOCALIZE = "localize"
    METRICS = "metrics"
    ADMIN = "admin"


SCOPES_OF_TOKENS = (Scope.MAPS_READ, Scope.MAPS_WRITE, Scope.LOCALIZE)
"""What a token may allow; a key needs one of them to be exchanged for a token."""

SCOPES_OF_ALL_MAPS = (Scope.METRICS, Scope.ADMIN)
"""What a key that is limited to maps cannot have."""


def needs(*scopes: Scope) -> Any:  # noqa: ANN401 - as FastAPI's own Security
    """Declare, among a route's `dependencies`, that a caller needs one of these scopes.

    `require_access` checks it; a route that declares none needs `admin`.
    """
    if not scopes:
        raise ValueError("no scope is given, wanted at least one")
    return Security(_declare, scopes=[scope.value for scope in scopes])


def needed_by(route: object) -> tuple[Scope, ...]:
    """Return the scopes of which a route needs one."""
    for dependency in getattr(route, "dependencies", ()):
        if isinstance(dependency, SecurityDependency) and dependency.dependency is _declare:
            return tuple(Scope(scope) for scope in dependency.scopes or ())
    return (Scope.ADMIN,)


async def _declare(
    _: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer_scheme)],
) -> None:
    """Do nothing: FastAPI documents it in the route's description."""


known(_declare)
