"""Answers requests that ended in a fault of the service, or that it stops before they ended."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.errors import ServiceBusy
from app.http.problems import internal_error, problem_response

_STOPPED = "the service is being stopped: send this again, what was stored of it stays"
_RESTARTED_S = 5


class Failures:
    """Inside of what completes answers, so that these have their id, and may be read by pages.

    Starlette's own handler of errors is the outermost of all.

    Args:
        app: The application within.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and answer it if nothing else did."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        has_begun = False

        async def noted(message: Message) -> None:
            nonlocal has_begun
            has_begun = has_begun or message["type"] == "http.response.start"
            await send(message)

        try:
            await self._app(scope, receive, noted)
        except asyncio.CancelledError:
            # Only Uvicorn cancels a request, at the end of its graceful shutdown.
            if not has_begun:
                await problem_response(ServiceBusy(_STOPPED, _RESTARTED_S))(scope, receive, send)
        except Exception as error:
            if has_begun:
                raise
            await internal_error(error)(scope, receive, send)
