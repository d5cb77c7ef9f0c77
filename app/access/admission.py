"""Admission: the key is checked, and the body prepared, before anything of the body is read."""

import logging
from typing import TYPE_CHECKING

from anyio import to_thread
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from app.http.bodies.bodies import prepared_body
from app.http.context import context_of, logged_path
from app.http.observing import BEHIND_THE_KEY
from app.http.problems import log_failure, problem_response
from core.errors import TensorMapError
from storage.catalog import NotKept

if TYPE_CHECKING:  # the service has this module's routes
    from app.service import Service

_log = logging.getLogger("tensormap.access")


async def _admit(service: "Service", connection: HTTPConnection) -> None:
    """Check the key: at once if it is kept in memory, else in a thread."""
    try:
        with service.store.catalog.kept_only():
            service.access.admit(connection)
    except NotKept:
        # Threads of its own: a key is looked up at once, also if all others are busy.
        await to_thread.run_sync(service.access.admit, connection, limiter=service.pools.admission)


class Admission:
    """Checks a request's key and the head of its body before the framework parses the body.

    Dependencies run too late for that: FastAPI parses JSON first. Its own `max_body_size` answers
    in plain text; our errors are problems.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with its caller and its body, of which nothing is read yet."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        service = scope["app"].state.service
        try:
            if scope["path"].startswith(BEHIND_THE_KEY):
                await _admit(service, HTTPConnection(scope))
            context_of(scope).body = prepared_body(scope, receive)
        except TensorMapError as error:
            log_failure(_log, f"the caller of {logged_path(scope)} cannot be checked", error)
            await problem_response(error)(scope, receive, send)
            return
        await self._app(scope, receive, send)
