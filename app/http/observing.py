"""Observes every request: gives it an id, completes its answer, counts it, and logs it."""

import logging
import time
from http import HTTPStatus

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.answer_headers import LIMIT, REQUEST_ID
from app.http.client import LEFT
from app.http.context import RequestContext, enter_request, logged_path
from app.http.logs import fields
from app.http.metrics import Metrics

_FOR_BROWSERS = (
    # Uploaded content is never run as a page or a script.
    (b"x-content-type-options", b"nosniff"),
    # No page of another site embeds ours, or loads an answer as an image or a script.
    (b"content-security-policy", b"frame-ancestors 'none'"),
    (b"cross-origin-resource-policy", b"same-origin"),
    # Paths have the names of maps.
    (b"referrer-policy", b"no-referrer"),
)
BEHIND_THE_KEY = ("/v1", "/metrics")
"""How the paths begin that need a key, so that no cache may give their answers to others."""
NO_ROUTE = "(none)"
"""What counts as the route of a request that none answered."""
_CACHED = frozenset({"GET", "HEAD"})  # caches keep no other answers, and those are to be short

_log = logging.getLogger("tensormap.requests")


class RequestObserver:
    """The outermost of our middlewares, which sees the answers of all others.

    Args:
        app: The application within.
        metrics: The metrics that count requests.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and observe its answer."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        context = enter_request(scope)

        async def observed(message: Message) -> None:
            kind = message["type"]
            if kind in {"http.response.start", "websocket.http.response.start"}:
                context.status = message["status"]
                _complete_head(message, context)
                if scope.get("method") in _CACHED and scope["path"].startswith(BEHIND_THE_KEY):
                    _keep_private(message)
            elif kind == "websocket.accept":
                context.status = 101
                _complete_head(message, context)
            await send(message)

        try:
            await self._app(scope, receive, observed)
        finally:
            self._report(scope, context, time.perf_counter() - began)

    def _report(self, scope: Scope, context: RequestContext, seconds: float) -> None:
        status = context.status or LEFT
        route = _template(scope)
        method = scope.get("method", "GET")
        if scope["type"] == "http":
            self._metrics.requested(route, method, status, seconds)
        client = scope.get("client")
        is_refused = context.problem is not None and status >= HTTPStatus.BAD_REQUEST
        refusal = {"problem": context.problem} if is_refused else {}
        _log.info(
            "request" if scope["type"] == "http" else "stream",
            extra=fields(
                method=method[:20],
                path=logged_path(scope),
                route=route,
                status=status,
                seconds=round(seconds, 6),
                client=client[0] if client else None,
                key=None if context.caller is None else context.caller.key_id,
                **refusal,
            ),
        )


def _complete_head(message: Message, context: RequestContext) -> None:
    """Add the fields that every answer has."""
    headers = MutableHeaders(scope=message)
    headers[REQUEST_ID] = context.request_id
    if message["type"] != "http.response.start":  # of a stream
        return
    given = {name for name, _ in headers.raw}
    headers.raw.extend(field for field in _FOR_BROWSERS if field[0] not in given)
    left = list(context.allowances.values())
    if left and LIMIT not in headers:  # a rejection has that of the limit that was reached
        for name in left[0]:
            headers[name] = ", ".join(of_unit[name] for of_unit in left)


def _keep_private(message: Message) -> None:
    """Let no cache give an answer to another caller, or without asking whether it is still true."""
    headers = MutableHeaders(scope=message)
    headers.setdefault("Cache-Control", "private, no-cache")
    headers.add_vary_header("Authorization")


def _template(scope: Scope) -> str:
    """Return the template of the route that answered, `NO_ROUTE` if none did."""
    template: str = getattr(scope.get("route"), "path", NO_ROUTE)
    return template
