"""Bodies of requests that take none: rejected, as unknown fields of JSON are.

What they ask for would be ignored: a restored map would not get the name that is in the body.
"""

from fastapi import Request
from fastapi.dependencies.models import Dependant

from app.http.bodies.bodies import BodyReader, incoming_of
from app.http.direct import known
from app.http.errors import InvalidRequest
from core.text import count_of

_NOTHING = b"{}"
"""What many clients send where they have nothing to say."""


def takes_body(dependant: Dependant) -> bool:
    """Return whether a route reads a body.

    Args:
        dependant: The route's, as FastAPI found it.
    """
    call = dependant.call
    return (
        isinstance(call, BodyReader)
        or call is incoming_of
        or any(map(takes_body, dependant.dependencies))
    )


async def require_no_body(request: Request) -> None:
    """Check that a `POST`, whose body has a meaning, has none if its `PooledRoute` takes none.

    An empty JSON object is none, and so is an empty body in chunks.

    Raises:
        InvalidRequest: If it has one.
    """
    if request.method != "POST" or request.scope["route"].takes_body:
        return
    size, body = int(request.headers.get("content-length") or 0), b""
    if "transfer-encoding" in request.headers or size == len(_NOTHING):
        incoming = incoming_of(request)
        with incoming.spool() as spool:
            await incoming.fill(spool)
            size, body = len(spool), b"".join(spool.pieces())
    if size and body != _NOTHING:
        raise InvalidRequest(f"this request takes no body, got {count_of(size, 'byte')}")


known(require_no_body, require_no_body)
