"""The scope and map that a route under /v1 requires; `admission` has checked the key."""

from typing import Annotated

from fastapi import Depends, Request, WebSocket
from fastapi.security import HTTPAuthorizationCredentials

from app.access.access import Access
from app.access.caller import Caller
from app.access.scopes import Scope, bearer_scheme, needed_by
from app.access.trail import record_caller
from app.http.context import context_of
from app.http.direct import known
from app.http.errors import KeyNeeded


async def require_access(
    request: Request,
    _: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer_scheme)],
) -> None:
    """Check the caller against the scopes that the route needs, and the map that it names."""
    caller = await _caller_of(request)
    record_caller(request, caller)
    _require(request, caller)


def require_access_still(request: Request) -> None:
    """Check the caller of a long request again, from a thread: its key may be revoked by now.

    Raises:
        HostNotAllowed: As in `Access.caller_of`.
        KeyNeeded: If the service has got keys meanwhile and none was sent.
        KeyRefused: If the key is no longer valid.
    """
    access: Access = request.app.state.service.access
    _require(request, access.caller_of(request))


def _require(request: Request, caller: Caller) -> None:
    caller.require(needed_by(request.scope["route"]))
    if (map_slug := request.path_params.get("map")) is not None:
        caller.require_map(map_slug)


def stream_caller(websocket: WebSocket, *scopes: Scope, map_slug: str) -> Caller:
    """Check the key of a stream: before it is accepted, and again with each message.

    Raises:
        HostNotAllowed: As in `Access.caller_of`.
        TooManyRequests: If the sender has reached its limit.
        KeyNeeded: If the service has keys and none was sent.
        KeyRefused: If the key is unknown, or no longer valid.
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
    if caller is None:  # `Admission` is not installed, or does not cover this path
        raise KeyNeeded("the key of this request was not checked")
    return caller


async def _checked(request: Request) -> None:
    await require_access(request, None)


known(require_access, _checked)
known(_caller_of, _caller_of)
CurrentCaller = Annotated[Caller, Depends(_caller_of)]
