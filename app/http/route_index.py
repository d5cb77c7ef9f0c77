"""An index of routes by method and length of the path, in place of trying one after another.

A request of a path with an encoded slash has no route: decoded, it would be the path of another
object. HEAD is answered by the route of GET. The server, Uvicorn, leaves out the body of its
answer.
"""

from collections.abc import Iterable

from fastapi.routing import APIRoute
from starlette.routing import BaseRoute, Match
from starlette.types import Receive, Scope, Send

from app.http.errors import NoSuchRoute

_SLASH = b"%2f"
_MOST_CHARACTERS = 200  # of a path


class RouteIndex(BaseRoute):
    """Finds the route of a request; it precedes the routes themselves, which answer all others.

    Args:
        routes: None of their parameters matches a slash.
    """

    def __init__(self, routes: Iterable[BaseRoute]) -> None:
        self._routes: dict[tuple[str, int], list[APIRoute]] = {}
        for route in routes:
            if isinstance(route, APIRoute):
                methods = set(route.methods or ())
                if "GET" in methods and not _sends_events(route):
                    methods.add("HEAD")
                for method in methods:
                    key = method, route.path.count("/")
                    self._routes.setdefault(key, []).append(route)

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Return the match of the first route that takes the request."""
        if scope["type"] == "http":
            if _SLASH in scope.get("raw_path", b"").lower():
                return Match.FULL, {"route": None}
            found = self._routes.get((scope["method"], scope["path"].count("/")), ())
            # FastAPI's routes know no HEAD, and its document would describe each with it.
            as_get = {**scope, "method": "GET"} if found and scope["method"] == "HEAD" else scope
            for route in found:
                match, child_scope = route.matches(as_get)
                if match is Match.FULL:
                    return match, child_scope
        return Match.NONE, {}

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request that `matches` found a route for.

        Raises:
            NoSuchRoute: If the path has an encoded slash.
        """
        if scope["route"] is None:
            path = scope["raw_path"][:_MOST_CHARACTERS].decode("latin-1")
            raise NoSuchRoute(f"there is no {path}: %2F is part of a name, and no name has a slash")
        # Not `handle`, which rejects HEAD; a file's answer has to know that it is HEAD.
        await scope["route"].app(scope, receive, send)


def _sends_events(route: APIRoute) -> bool:
    """Return whether the answer goes on until something ends: the head alone would take as long."""
    return "text/event-stream" in route.responses.get(200, {}).get("content", {})
