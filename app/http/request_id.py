"""The id of the request that is being answered: in the answer, in every problem and log line."""

import re
import secrets
from contextvars import ContextVar

__all__ = ["HEADER", "accepted_id", "current_id", "enter_request"]

HEADER = "X-Request-Id"

_SANE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")
_ID_BYTES = 12
_current: ContextVar[str | None] = ContextVar("tensormap_request_id", default=None)


def accepted_id(sent: str | None) -> str:
    """Return the id that a client or proxy sent if it can stand in a log, or else a new one.

    Examples:
        >>> accepted_id("truck-7:42")
        'truck-7:42'
        >>> len(accepted_id("two words"))
        24
    """
    return sent if sent and _SANE.fullmatch(sent) else secrets.token_hex(_ID_BYTES)


def enter_request(request_id: str) -> None:
    """Let all that this task does from now on, in other threads too, be of this request."""
    _current.set(request_id)


def current_id() -> str | None:
    """Return the id of the request that is being answered, `None` outside of one."""
    return _current.get()
