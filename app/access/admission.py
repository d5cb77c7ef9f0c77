"""The key comes first: nothing of a request is read, parsed or looked at before it."""

import logging
from http import HTTPStatus

from anyio import to_thread
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from app.access.access import Access
from app.http.problems import problem_response
from core.errors import TensorMapError

_BEHIND_THE_KEY = ("/v1", "/metrics")

_log = logging.getLogger("tensormap.access")


class Admission:
    """Finds out who asks before the framework parses a body, and refuses who has no key.

    Dependencies come too late for that: FastAPI parses JSON first.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with its caller."""
        if scope["type"] != "http" or not scope["path"].startswith(_BEHIND_THE_KEY):
            await self._app(scope, receive, send)
            return
        service = scope["app"].state.service
        access: Access = service.access
        try:
            # Threads of its own: whatever others do, a key is looked up at once.
            await to_thread.run_sync(
                access.admit, HTTPConnection(scope), limiter=service.pools.admission
            )
        except TensorMapError as error:
            response = problem_response(error)
            if response.status_code >= HTTPStatus.INTERNAL_SERVER_ERROR:
                _log.exception("who asks for %s cannot be found out", scope["path"])
            await response(scope, receive, send)
            return
        await self._app(scope, receive, send)
