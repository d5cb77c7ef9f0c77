"""What a route under /v1 requires of the caller; the key itself is found in `admission`."""

from typing import Annotated

from fastapi import Depends, Request, WebSocket
from fastapi.security import HTTPAuthorizationCredentials

from app.access.access import Access
from app.access.caller import Caller
from app.access.scopes import Scope, bearer_scheme, needed_by
from app.access.trail import sign
from app.http.context import context_of
from app.http.errors import KeyNeeded


async def require_access(
    request: Request,
    _: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer_scheme)],
) -> None:
    """Check whoever was admitted against what the route needs, and the map that it names."""
    caller = await _caller_of(request)
    sign(request, caller)
    caller.require(needed_by(request.scope["route"]))
    if (map_slug := request.path_params.get("map")) is not None:
        caller.require_map(map_slug)


def stream_caller(websocket: WebSocket, *scopes: Scope, map_slug: str) -> Caller:
    """Check the key of a stream: before it is accepted, and again with each message.

    Raises:
        HostNotAllowed: As `Access.caller_of` does, and so on.
        TooManyRequests: If it asks too often.
        KeyNeeded: If the service has keys and none came.
        KeyRefused: If the key is none of them, or no longer.
        ScopeMissing: If it allows none of the scopes.
        MapNotFound: If it is limited to other maps.
    """
    access: Access = websocket.app.state.service.access
    caller = access.admit(websocket)
    caller.require(scopes)
    caller.require_map(map_slug)
    return caller


async def _caller_of(request: Request) -> Caller:
    caller = context_of(request.scope).caller
    if caller is None:  # `Admission` is not there, or does not know this path
        raise KeyNeeded("nobody has looked at the key of this request")
    return caller


Asking = Annotated[Caller, Depends(_caller_of)]
