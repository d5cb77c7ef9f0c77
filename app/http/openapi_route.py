"""The OpenAPI document over HTTP: built once, in a thread, and kept as bytes."""

import hashlib
import json
from http import HTTPStatus

from fastapi import FastAPI, Request
from starlette.responses import Response
from starlette.routing import Route

from app.http.answer_headers import ETAG
from app.http.context import context_of
from app.http.etags import is_held
from app.http.pools import Pools


class _Document:
    """The document of an application, as it is sent."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self._body = b""

    async def answer(self, request: Request) -> Response:
        """Return the document, or nothing if the client has it.

        Raises:
            TooManyRequests: If it is not built yet, and too much heavy work of the sender waits.
            ServiceBusy: If it is not built yet, and too much heavy work waits.
        """
        if not self._body:
            # Not at the start, which it would delay, nor on the event loop: it takes seconds.
            pools: Pools = request.app.state.service.pools
            await pools.heavy.run_shared(context_of(request.scope).sender, self, self._build)
        headers = {ETAG: self._etag}
        if is_held(self._etag, request.headers.get("if-none-match")):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        return Response(self._body, media_type="application/json", headers=headers)

    def _build(self) -> None:
        if self._body:  # built meanwhile, for a request that had its turn before
            return
        text = json.dumps(self._app.openapi(), ensure_ascii=False, separators=(",", ":"))
        body = text.encode()
        self._etag = f'"{hashlib.sha256(body).hexdigest()}"'
        self._body = body


def serve_openapi(app: FastAPI) -> None:
    """Replace FastAPI's route of the document, which writes it anew for each request."""
    routes, url = app.router.routes, str(app.openapi_url)
    [place] = [
        number
        for number, route in enumerate(routes)
        if isinstance(route, Route) and route.path == url
    ]
    routes[place] = Route(url, _Document(app).answer, include_in_schema=False)
