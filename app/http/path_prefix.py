"""The service under a path of a host that it shares, behind a proxy."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.answer_headers import LOCATION

_PAGE = "/docs"  # FastAPI writes where its files are into it, by `root_path`
_LOCATION = LOCATION.lower().encode()


class PathPrefix:
    """Removes a prefix from the path of each request, and puts it before that of its `Location`.

    A proxy may remove it or pass it on. Whatever is within sees paths without it: those that need
    a key are known by how they begin.

    Args:
        app: The application within.
        prefix: As `/tensormap`.
    """

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app, self._prefix = app, prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        path = self._within(scope["path"])
        root_path = self._prefix if path == _PAGE else ""

        async def prefixed(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [self._located(*header) for header in message["headers"]]
            await send(message)

        await self._app({**scope, "path": path, "root_path": root_path}, receive, prefixed)

    def _within(self, path: str) -> str:
        if path == self._prefix:
            return "/"
        return path.removeprefix(self._prefix) if path.startswith(f"{self._prefix}/") else path

    def _located(self, name: bytes, value: bytes) -> tuple[bytes, bytes]:
        if name.lower() == _LOCATION and value.startswith(b"/"):
            return name, self._prefix.encode() + value
        return name, value
