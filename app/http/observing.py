"""Watches every request: gives it an id, counts it, and writes a line about it."""

import asyncio
import logging
import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.answer_headers import complete_head
from app.http.context import RequestContext, enter_request
from app.http.errors import ServiceBusy
from app.http.logs import fields
from app.http.metrics import Metrics
from app.http.problems import internal_error, problem_response

_MOST_CHARACTERS = 200  # of a path that a log repeats
_STOPPED = "the service is being stopped: send this again, what was stored of it stays"
_STARTED_AGAIN_S = 5
_NO_ANSWER = 499  # what proxies note of a client that went away; it is never sent

_log = logging.getLogger("tensormap.requests")


class RequestObserver:
    """The outermost of our middlewares: what others answer by themselves is seen too.

    Args:
        app: What answers.
        metrics: Where requests are counted.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and watch what is answered."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        context = enter_request(scope)

        async def watched(message: Message) -> None:
            kind = message["type"]
            if kind in {"http.response.start", "websocket.http.response.start"}:
                context.status = message["status"]
                complete_head(message, context)
            elif kind == "websocket.accept":
                context.status = 101
                complete_head(message, context)
            await send(message)

        try:
            await self._app(scope, receive, watched)
        except asyncio.CancelledError:
            # Only Uvicorn cancels a request: it is to stop, and has waited as long as it does.
            if scope["type"] != "http":
                raise
            if context.status is None:
                await problem_response(ServiceBusy(_STOPPED, _STARTED_AGAIN_S))(
                    scope, receive, watched
                )
        except Exception as error:
            if scope["type"] != "http" or context.status is not None:
                raise
            # Starlette's own last resort is outside of us: its answer would have no id.
            await internal_error(error)(scope, receive, watched)
        finally:
            self._tell(scope, context, time.perf_counter() - began)

    def _tell(self, scope: Scope, context: RequestContext, seconds: float) -> None:
        status = context.status or _NO_ANSWER
        route = _template(scope)
        method = scope.get("method", "GET")
        if scope["type"] == "http":
            self._metrics.requested(route, method, status, seconds)
        client = scope.get("client")
        _log.info(
            "request" if scope["type"] == "http" else "stream",
            extra=fields(
                method=method[:20],
                path=scope["path"][:_MOST_CHARACTERS],
                route=route,
                status=status,
                seconds=round(seconds, 6),
                client=client[0] if client else None,
                key=None if context.caller is None else context.caller.key_id,
            ),
        )


def _template(scope: Scope) -> str:
    """Return the template of the route that answered, `(none)` if none did."""
    template = getattr(scope.get("route"), "path", None)
    if template is None:
        return "(none)"
    # The route knows its path within its router only. No part of ours has a slash in it, so what
    # the path has before that is the routers' prefix.
    parts, own = scope["path"].split("/"), template.split("/")
    return "/".join(parts[: max(len(parts) - len(own) + 1, 1)] + own[1:])
