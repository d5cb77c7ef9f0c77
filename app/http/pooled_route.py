"""Routes in a pool: the body is received, then the function runs in the pool `short` or `heavy`.

A plain function under `@router.get(...)` runs in the short pool, with `@heavy` below that in the
heavy one. Its body is received before, on the event loop: a thread is taken only when it is
complete. A request with a large or compressed body is heavy work in any case. The thread writes the
JSON of the answer too.

With `@light` a function is called on the event loop if all that it reads of the catalog is kept in
memory: a thread would take longer than it. With `@quick` one with a small body is called there, in
its sender's turn, if it is known to take some milliseconds.
"""

import asyncio
import inspect
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request, Response
from fastapi.routing import APIRoute, serialize_response
from pydantic import BaseModel

from app.http.bodies.bodies import BodyReader, Received, described_body, incoming_of
from app.http.bodies.incoming import Incoming
from app.http.bodies.json_body import SMALL_BYTES
from app.http.bodies.no_body import require_no_body, takes_body
from app.http.client import Client
from app.http.context import context_of
from app.http.direct import Solver, Unsolvable, known
from app.http.errors import InvalidRequest
from app.http.pools import Pools
from app.http.problems import problems
from app.http.query_names import QueryNames, require_query_names
from app.quick_work import NotQuick
from storage.catalog import NotKept

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

_MARK, _LIGHT, _QUICK = "tensormap_heavy", "tensormap_light", "tensormap_quick"
_ANY_QUERY = "tensormap_any_query"
_REQUEST = "pooled_request"


def heavy(function: F) -> F:
    """Run a route's function in the heavy pool; declared below the route."""
    setattr(function, _MARK, True)
    return function


def heavy_if(is_heavy: Callable[[dict[str, Any]], bool]) -> Callable[[F], F]:
    """Run a route's function in the heavy pool if its arguments ask for it; declared likewise.

    Args:
        is_heavy: Returns whether they do, from the arguments by their names.
    """

    def mark(function: F) -> F:
        setattr(function, _MARK, is_heavy)
        return function

    return mark


def light(function: F) -> F:
    """Run a route's function without a thread if it needs no query; declared below the route.

    It takes far less than a millisecond then, and until its first query it changes nothing.
    """
    setattr(function, _LIGHT, True)
    return function


def quick(function: F) -> F:
    """Run a route's function without a thread if it is quick; declared below the route.

    See `app.quick_work`: it measures itself.
    """
    setattr(function, _QUICK, True)
    return function


def any_query(function: F) -> F:
    """Take a query that the route does not have, as of a probe; declared below the route."""
    setattr(function, _ANY_QUERY, True)
    return function


class PooledRoute(APIRoute):
    """A route that runs its function in a pool, unless that is asynchronous.

    Attributes:
        query_names: The names of its parameters; a request with others is rejected, unless it takes
            any.
        takes_body: Whether it reads a body; a `POST` with one is rejected if not.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:  # noqa: ANN401
        checks = list(options.pop("dependencies", None) or ())
        if not getattr(endpoint, _ANY_QUERY, False):
            checks += [Depends(require_query_names), Depends(require_no_body)]
            options["responses"] = problems(InvalidRequest) | (options.get("responses") or {})
        if not inspect.iscoroutinefunction(endpoint):
            if (model := _json_of(endpoint)) is not None:
                options["openapi_extra"] = described_body({}, model)
            endpoint = _pooled(endpoint, self._answer)
        super().__init__(path, endpoint, dependencies=checks, **options)
        self.query_names = QueryNames(self.dependant)
        self.takes_body = takes_body(self.dependant)

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return what answers a request: without FastAPI's solver if the parameters allow it."""
        general = super().get_route_handler()
        try:
            solver = Solver(self.dependant)
        except Unsolvable:
            return general
        function = self.dependant.call
        assert function is not None  # noqa: S101 - a route has one

        async def direct(request: Request) -> Response:
            try:
                given = await solver.solve(request, request.scope["fastapi_inner_astack"])
            except Unsolvable:
                return await general(request)
            found = self._answer(await function(**given), given)
            if isinstance(found, Response):
                return found
            content = await serialize_response(
                field=self.response_field, response_content=found, dump_json=True
            )
            return self._response(content, given)

        return direct

    def _answer(self, found: Any, given: dict[str, Any]) -> Any:  # noqa: ANN401
        """Return the response with a model, or with nothing; others as they are."""
        if found is None and self.status_code == HTTPStatus.NO_CONTENT:
            return self._response(b"", given)
        if not isinstance(found, BaseModel) or type(found) is not self.response_model:
            return found
        # It was validated when it was made.
        return self._response(found.__pydantic_serializer__.to_json(found, by_alias=True), given)

    def _response(self, content: bytes, given: dict[str, Any]) -> Response:
        """Return a response with the head that the function asked for."""
        asked = next((value for value in given.values() if type(value) is Response), None)
        status = (asked and asked.status_code) or self.status_code or HTTPStatus.OK
        kind = "application/json" if content else None
        response = Response(content, status, media_type=kind)
        if asked is not None:
            response.headers.raw.extend(asked.headers.raw)
        return response


def _json_of(function: Callable[..., Any]) -> type[BaseModel] | None:
    """Return the model of the function's `Json[...]`, `None` if it takes no JSON."""
    for parameter in inspect.signature(function).parameters.values():
        for mark in getattr(parameter.annotation, "__metadata__", ()):
            reader = getattr(mark, "dependency", None)
            if isinstance(reader, BodyReader) and reader.model is not None:
                return reader.model
    return None


def _pooled(
    function: Callable[..., Any], answer: Callable[[Any, dict[str, Any]], Any]
) -> Callable[..., Any]:
    """Return the function as FastAPI calls it: with the request, on the event loop."""
    mark, is_light = getattr(function, _MARK, False), getattr(function, _LIGHT, False)
    may_be_quick = getattr(function, _QUICK, False)

    async def in_pool(**given: Any) -> Any:  # noqa: ANN401 - what the function takes and returns
        request: Request = given.pop(_REQUEST)
        bodies = [value for value in given.values() if isinstance(value, Received)]
        work = partial(_call, function, given, answer)
        service = request.app.state.service
        kept_only = service.store.catalog.kept_only
        if is_light:
            with suppress(NotKept), kept_only():
                return work()
        pools: Pools = service.pools
        is_heavy = mark(given) if callable(mark) else mark
        size = sum(map(len, bodies))
        pool = pools.of_body(size)
        if is_heavy or pool is pools.heavy or any(body.packed for body in bodies):
            return await run_heavy(request, work)
        sender = context_of(request.scope).sender
        if may_be_quick and size <= SMALL_BYTES:
            with suppress(NotQuick):
                return await pools.at_once(sender, work, kept_only)
        return await pools.when_loaded(sender, partial(pool.run, sender), work)

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


async def _incoming(request: Request) -> Incoming:
    return incoming_of(request)


known(_itself, _itself)
known(incoming_of, _incoming)


async def run_heavy(request: Request, work: Callable[[], T], *, begun: bool = False) -> T:
    """Return what `work` returns, from a thread of the heavy pool.

    Args:
        request: The request; `require_client` stops the work when the client has left.
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


def _call(
    function: Callable[..., Any],
    given: dict[str, Any],
    answer: Callable[[Any, dict[str, Any]], Any],
) -> Any:  # noqa: ANN401
    """Call a route's function with its body opened, and write its answer; in a thread."""
    found = function(
        **{name: v.open() if isinstance(v, Received) else v for name, v in given.items()}
    )
    return answer(found, given)
