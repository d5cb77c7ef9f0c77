"""What the head of every answer says besides: what is left to a key, and what a browser may do."""

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.context import context_of

__all__ = ["AnswerHeaders"]

_FOR_BROWSERS = {
    # What was uploaded is never taken for a page or a script.
    "X-Content-Type-Options": "nosniff",
    # No page elsewhere lays ours under its own, or loads an answer as an image or a script.
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    # Names of maps are in the paths.
    "Referrer-Policy": "no-referrer",
}


class AnswerHeaders:
    """Adds fields to each answer that does not have them."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        context = context_of(scope)

        async def completed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _FOR_BROWSERS.items():
                    headers.setdefault(name, value)
                left = [one.headers() for one in context.allowances.values()]
                if left and "RateLimit" not in headers:  # a refusal tells of the limit it met
                    for name in left[0]:
                        headers[name] = ", ".join(said[name] for said in left)
            await send(message)

        await self._app(scope, receive, completed)
