"""The fields of an answer's head that clients rely on, as routes name and describe them."""

from typing import Any

ACCEPT_RANGES = "Accept-Ranges"
ALLOW = "Allow"
CONTENT_DISPOSITION = "Content-Disposition"
CONTENT_RANGE = "Content-Range"
ETAG = "ETag"
LAST_MODIFIED = "Last-Modified"
LAST_SEQUENCE = "TensorMap-Last-Sequence"
LEAST_CELLS = "TensorMap-Least-Cells"
LOCATION = "Location"
POLICY = "RateLimit-Policy"
LIMIT = "RateLimit"
RETRY_AFTER = "Retry-After"
REQUEST_ID = "X-Request-Id"
UPGRADE = "Upgrade"
AUTHENTICATE = "WWW-Authenticate"

_TEXT, _SECONDS = {"type": "string"}, {"type": "integer", "minimum": 0}
_FIELDS: dict[str, tuple[str, dict[str, Any]]] = {
    ACCEPT_RANGES: ("`bytes`: parts can be requested with `Range`.", _TEXT),
    CONTENT_DISPOSITION: ("The name under which a browser saves the file.", _TEXT),
    CONTENT_RANGE: ("Which bytes of how many these are; of 416 how many there are.", _TEXT),
    ETAG: (
        "The version of what is answered: of a map for `If-Match`, else for `If-None-Match`.",
        _TEXT,
    ),
    LAST_MODIFIED: ("When the file was stored, for `If-Range`.", _TEXT),
    LAST_SEQUENCE: (
        "The number of the track's last observation that had one, `none` if none had.",
        {"type": "string", "pattern": "^(none|[0-9]+)$"},
    ),
    LEAST_CELLS: (
        "How many occupied cells an image of the revision must have.",
        {"type": "integer", "minimum": 0},
    ),
    LOCATION: ("The path of what was made, or of the job to follow.", _TEXT),
    POLICY: ("The limits of the key: how much in which time.", _TEXT),
    LIMIT: ("How much of each limit is left, and when it is whole again.", _TEXT),
    RETRY_AFTER: (
        "After how many seconds to try again; not where only the client can make room.",
        _SECONDS,
    ),
    UPGRADE: ("The protocol that the request has to name.", _TEXT),
    AUTHENTICATE: ("What kind of key is needed, and with which scope (RFC 6750).", _TEXT),
    REQUEST_ID: ("Id of the request, in the service's log too.", _TEXT),
}
# Of answers with these statuses, whatever the route.
_BY_STATUS: dict[str, dict[str, bool]] = {
    "401": {AUTHENTICATE: True},
    "403": {AUTHENTICATE: True},
    "416": {CONTENT_RANGE: True},
    "426": {UPGRADE: True},
    "429": {RETRY_AFTER: False},
    "503": {RETRY_AFTER: False},
}


def headed(*always: str, sometimes: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the part of an OpenAPI response that describes fields of its head.

    Args:
        always: Names of the fields that each such answer has.
        sometimes: Names of the fields that some of them have.

    Examples:
        >>> headed(LOCATION)["headers"]["Location"]["required"]
        True
    """
    return {
        "headers": _described({**dict.fromkeys(always, True), **dict.fromkeys(sometimes, False)})
    }


def describe_heads(operation: dict[str, Any]) -> None:
    """Add the fields to an operation's answers that depend on their status only."""
    everywhere = {REQUEST_ID: True}
    if operation.get("security"):
        everywhere |= {POLICY: False, LIMIT: False}
    for status, answer in operation["responses"].items():
        added = _described({**_BY_STATUS.get(status, {}), **everywhere})
        answer["headers"] = {**answer.get("headers", {}), **added}


def _described(names: dict[str, bool]) -> dict[str, Any]:
    return {
        name: {"description": _FIELDS[name][0], "required": required, "schema": _FIELDS[name][1]}
        for name, required in names.items()
    }
