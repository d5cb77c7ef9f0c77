"""Errors made of answers: of the service's problem documents, and of redirections."""

import json
from collections.abc import Mapping
from email.utils import parsedate_to_datetime
from typing import Any

from tensormap_client.errors import Rejected, Unreachable, UnreachableByProxy
from tensormap_client.problems import PROBLEMS

_MOST_CHARACTERS = 500
_OF_PROXIES = {502, 503, 504}


def rejection(
    request: str, status: int, body: bytes | str, headers: Mapping[str, str] | None = None
) -> Rejected:
    """Return the error for an answer: the class of its problem, or `Rejected` if that is unknown.

    One without a problem document, of a status that proxies answer by themselves, is one of those.

    Args:
        request: The request, for the message.
        status: The answer's HTTP status.
        body: The answer's body.
        headers: The answer's headers.
    """
    problem, detail, set_aside, kind = "", "", (), Rejected
    try:
        answer: Any = json.loads(body)
        problem, detail = str(answer["type"]).rpartition("/")[2], str(answer["detail"])
        set_aside = tuple(answer.get("set_aside") or ())
    except (ValueError, KeyError, TypeError):
        text = body.decode(errors="replace") if isinstance(body, bytes) else body
        if status in _OF_PROXIES:
            kind = UnreachableByProxy
            text = f"a proxy answered for the service, which may still do what was asked: {text}"
        detail = text[:_MOST_CHARACTERS]
    message = " ".join(
        filter(None, [f"{request}:", str(status), problem and f"{problem}:", detail])
    )
    error = PROBLEMS.get(problem, kind)(
        message, status, problem, detail, _retry_after_s(headers or {})
    )
    error.set_aside = set_aside
    return error


def _retry_after_s(headers: Mapping[str, str]) -> float:
    """Return the seconds of `Retry-After`; those until a date, of a proxy, by the proxy's clock."""
    wait = headers.get("Retry-After", "")
    if wait.isdecimal():
        return float(wait)
    try:
        now, then = (parsedate_to_datetime(headers[name]) for name in ("Date", "Retry-After"))
        return max((then - now).total_seconds(), 0.0)
    except (KeyError, TypeError, ValueError):
        return 0.0


def redirection(request: str, headers: Mapping[str, str]) -> Unreachable:
    """Return the error for a redirection: of a hotspot or a proxy, the service sends none.

    It is not followed: another host would get the key.
    """
    return Unreachable(
        f"{request}: redirected to {headers.get('Location', '')[:_MOST_CHARACTERS]!r}, wanted the"
        " service itself: is the URL right, or does a login come first?"
    )
