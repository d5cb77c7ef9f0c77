"""Fields of every answer: its id, what is left to a key, and what a browser may do with it."""

from starlette.datastructures import MutableHeaders
from starlette.types import Message

from app.http.context import HEADER, RequestContext

_FOR_BROWSERS = {
    # What was uploaded is never taken for a page or a script.
    "X-Content-Type-Options": "nosniff",
    # No page elsewhere lays ours under its own, or loads an answer as an image or a script.
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    # Names of maps are in the paths.
    "Referrer-Policy": "no-referrer",
}


def complete_head(message: Message, context: RequestContext) -> None:
    """Add the fields of every answer that its head does not have."""
    headers = MutableHeaders(scope=message)
    headers[HEADER] = context.request_id
    if message["type"] != "http.response.start":  # of a stream
        return
    for name, value in _FOR_BROWSERS.items():
        headers.setdefault(name, value)
    left = [one.headers() for one in context.allowances.values()]
    if left and "RateLimit" not in headers:  # a refusal has that of the limit that it met
        for name in left[0]:
            headers[name] = ", ".join(said[name] for said in left)
