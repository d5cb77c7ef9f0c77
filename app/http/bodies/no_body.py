"""Bodies of requests that take none: rejected, as unknown fields of JSON are.

What they ask for would be ignored: a restored map would not get the name that is in the body.
"""

from fastapi import Request
from fastapi.dependencies.models import Dependant

from app.http.bodies.bodies import BodyReader, incoming_of
from app.http.direct import known
from app.http.errors import InvalidRequest
from core.text import count_of


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

    Raises:
        InvalidRequest: If it has one.
    """
    if request.method != "POST" or request.scope["route"].takes_body:
        return
    size = int(request.headers.get("content-length") or 0)
    if "transfer-encoding" in request.headers:  # some clients send an empty body in chunks
        incoming = incoming_of(request)
        with incoming.spool() as spool:
            await incoming.fill(spool)
            size = len(spool)
    if size:
        raise InvalidRequest(f"this request takes no body, got {count_of(size, 'byte')}")


known(require_no_body, require_no_body)
