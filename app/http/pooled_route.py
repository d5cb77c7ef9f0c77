"""Routes in a pool: the body is received, then the function runs in the pool `short` or `heavy`.

A plain function under `@router.get(...)` runs in the short pool, with `@heavy` below that in the
heavy one. Its body is received before, on the event loop: a thread is taken only when it is
complete. A request with a large or compressed body is heavy work in any case.
"""

import asyncio
import inspect
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Request
from fastapi.routing import APIRoute
from pydantic import BaseModel

from app.http.bodies.bodies import BodyReader, Received, described_body, incoming_of
from app.http.client import Client
from app.http.context import context_of
from app.http.pools import Pools

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

_MARK = "tensormap_heavy"
_REQUEST = "pooled_request"


def heavy(function: F) -> F:
    """Run a route's function in the heavy pool; declared below the route."""
    setattr(function, _MARK, True)
    return function


def pooled_router(**options: Any) -> APIRouter:  # noqa: ANN401 - those of `APIRouter`
    """Return a router whose routes run in pools."""
    return APIRouter(route_class=PooledRoute, **options)


class PooledRoute(APIRoute):
    """A route that runs its function in a pool, unless that is asynchronous."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:  # noqa: ANN401
        if not inspect.iscoroutinefunction(endpoint):
            if (model := _json_of(endpoint)) is not None:
                options["openapi_extra"] = described_body({}, model)
            endpoint = _pooled(endpoint)
        super().__init__(path, endpoint, **options)


def _json_of(function: Callable[..., Any]) -> type[BaseModel] | None:
    """Return the model of the function's `Json[...]`, `None` if it takes no JSON."""
    for parameter in inspect.signature(function).parameters.values():
        for mark in getattr(parameter.annotation, "__metadata__", ()):
            reader = getattr(mark, "dependency", None)
            if isinstance(reader, BodyReader) and reader.model is not None:
                return reader.model
    return None


def _pooled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function as FastAPI calls it: with the request, on the event loop."""
    is_heavy = getattr(function, _MARK, False)

    async def in_pool(**given: Any) -> Any:  # noqa: ANN401 - what the function takes and returns
        request: Request = given.pop(_REQUEST)
        bodies = [value for value in given.values() if isinstance(value, Received)]
        work = partial(_call, function, given)
        pools: Pools = request.app.state.service.pools
        pool = pools.of_body(sum(map(len, bodies)))
        if is_heavy or pool is pools.heavy or any(body.packed for body in bodies):
            return await run_heavy(request, work)
        return await pool.run(context_of(request.scope).sender, work)

    signature = inspect.signature(function)
    # By a dependency: FastAPI passes the request itself to one parameter only.
    of_it = Annotated[Request, Depends(_itself)]
    added = inspect.Parameter(_REQUEST, inspect.Parameter.KEYWORD_ONLY, annotation=of_it)
    in_pool.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*signature.parameters.values(), added]
    )
    in_pool.__name__, in_pool.__doc__ = function.__name__, function.__doc__
    in_pool.__module__, in_pool.__qualname__ = function.__module__, function.__qualname__
    return in_pool


async def _itself(request: Request) -> Request:
    return request


async def run_heavy(request: Request, work: Callable[[], T], *, begun: bool = False) -> T:
    """Return what `work` returns, from a thread of the heavy pool.

    Args:
        request: Its request; `require_client` stops the work when the client has left.
        work: Called in the thread.
        begun: It continues earlier work, and may wait even if the queue is full.

    Raises:
        TooManyRequests: If too much heavy work of the caller waits.
        ServiceBusy: If too much heavy work waits.
        ClientDisconnect: If the client left.
    """
    pools: Pools = request.app.state.service.pools
    client = Client()
    # While a body is received, its reader notices that the client left.
    partly = incoming_of(request).is_partial
    task = None if partly else asyncio.create_task(client.watch(request.receive))
    try:
        with client.waiting():
            return await pools.heavy.run(
                context_of(request.scope).sender, work, client=client, begun=begun
            )
    finally:
        if task is not None:
            task.cancel()


def _call(function: Callable[..., Any], given: dict[str, Any]) -> Any:  # noqa: ANN401
    """Call a route's function with its body opened; in a thread."""
    return function(
        **{name: v.open() if isinstance(v, Received) else v for name, v in given.items()}
    )
