"""The context of a request: its id, sender and body, for logs, limits and answers."""

import re
import secrets
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from urllib.parse import quote

from starlette.datastructures import Headers
from starlette.types import Scope

from app.http.answer_headers import POLICY, REQUEST_ID
from app.http.redaction import without_keys

if TYPE_CHECKING:  # these import modules that log, and every log line reads the context
    from app.access.caller import Caller
    from app.http.bodies.incoming import Incoming

_KEY = "tensormap"
_SANE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")
_ID_BYTES = 12
_MOST_CHARACTERS = 200  # of a path


@dataclass(slots=True)
class RequestContext:
    """The context of one request, which its middlewares fill in, from the outermost inwards.

    Attributes:
        request_id: The request's id, as in `X-Request-Id`, in problems and in the log.
        sender: The sender, for limits and shares: id of a key, or the client's address.
        caller: Who sent it, after its key was checked; `None` on routes that need none.
        allowances: Header fields of what is left to the sender, by policy.
        body: The request's body, of which nothing is read before the route reads it.
        audited: Whether its failure is recorded in the audit log.
        status: The status of the answer, once that has begun.
        problem: The name of the last problem that was made for it.
    """

    request_id: str
    sender: str
    caller: "Caller | None" = None
    allowances: dict[str, dict[str, str]] = field(default_factory=dict)
    body: "Incoming | None" = None
    audited: bool = False
    status: int | None = None
    problem: str | None = None

    def allow(self, left: dict[str, str]) -> None:
        """Record what is left to the sender, for the head of the answer."""
        if left:
            self.allowances[left[POLICY]] = left


_current: ContextVar[RequestContext | None] = ContextVar("tensormap_request", default=None)


def enter_request(scope: Scope) -> RequestContext:
    """Return a new context, which is current for this task and its threads from now on."""
    client = scope.get("client")
    context = RequestContext(
        accepted_id(Headers(scope=scope).get(REQUEST_ID)), f"address {client[0] if client else ''}"
    )
    scope.setdefault("state", {})[_KEY] = context
    _current.set(context)
    return context


def context_of(scope: Scope) -> RequestContext:
    """Return the context of a request or stream."""
    context: RequestContext = scope["state"][_KEY]
    return context


def current_context() -> RequestContext | None:
    """Return the context of the request that is being answered, `None` outside of one."""
    return _current.get()


def current_id() -> str | None:
    """Return the id of the request that is being answered, `None` outside of one."""
    context = current_context()
    return None if context is None else context.request_id


def logged_path(scope: Scope) -> str:
    """Return the path of a request for the log, as it is sent: one word, whatever it has.

    Examples:
        >>> logged_path({"path": "/v1/maps/a b"})
        '/v1/maps/a%20b'
    """
    return without_keys(quote(scope["path"]))[:_MOST_CHARACTERS]


def accepted_id(sent: str | None) -> str:
    """Return the id that a client or proxy sent if a log can hold it, or else a new one.

    Examples:
        >>> accepted_id("truck-7:42")
        'truck-7:42'
        >>> len(accepted_id("two words"))
        24
    """
    return sent if sent and _SANE.fullmatch(sent) else secrets.token_hex(_ID_BYTES)
