"""The service's answers that are problems, as errors."""

import json
from collections.abc import Mapping
from typing import Any

from tensormap_client.errors import Rejected
from tensormap_client.problems import PROBLEMS

_MOST_CHARACTERS = 500


def rejection(
    request: str, status: int, body: bytes | str, headers: Mapping[str, str] | None = None
) -> Rejected:
    """Return the error of an answer: of its problem's class, `Rejected` if that is not known.

    Args:
        request: What was requested, for the message.
        status: Of the answer.
        body: Of the answer.
        headers: Of the answer.
    """
    problem, detail, set_aside = "", "", ()
    try:
        answer: Any = json.loads(body)
        problem, detail = str(answer["type"]).rpartition("/")[2], str(answer["detail"])
        set_aside = tuple(answer.get("set_aside") or ())
    except (ValueError, KeyError, TypeError):
        text = body.decode(errors="replace") if isinstance(body, bytes) else body
        detail = text[:_MOST_CHARACTERS]
    wait = (headers or {}).get("Retry-After", "")
    message = " ".join(
        filter(None, [f"{request}:", str(status), problem and f"{problem}:", detail])
    )
    kind = PROBLEMS.get(problem, Rejected)
    error = kind(message, status, problem, detail, float(wait) if wait.isdecimal() else 0.0)
    error.set_aside = set_aside
    return error
