"""Logs: one line for each event, as text or JSON, without keys, bodies and queries.

The standard library is used for the reasons in docs/decisions/0020-operation.md.
"""

import json
import logging
import math
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, TextIO

from app.http.context import current_id
from app.http.redaction import without_keys
from app.settings import LogFormat
from core.text import escaped

_FIELDS = "tensormap_fields"
# Uvicorn's lines about streams: one has the query, another takes a rejection for an error.
_OF_STREAMS = (
    '%s - "WebSocket ',
    "connection open",
    "connection rejected",
    "connection closed",
    "ASGI callable returned without completing handshake.",
)
MALFORMED = "Invalid HTTP request received."
"""What is logged of a request that is answered with 400 because it cannot be parsed."""
_NOT_TEXT = "Invalid UTF-8 sequence received from client."
_CAUSED = (
    "socket.accept() out of system resource",
    MALFORMED,
    _NOT_TEXT,
)
_THROTTLE_S = 10.0
_UNNAMED = ("time", "level", "logger", "event")  # values without their names in a line of text


def fields(**values: object) -> dict[str, Any]:
    """Return the `extra` of a record with these fields."""
    return {_FIELDS: values}


def configure_logging(
    log_format: LogFormat, level: str = "INFO", stream: TextIO | None = None
) -> None:
    """Write the log of this process to standard error, and nowhere else."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(LineFormatter(log_format))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    for name in ("tensormap", "uvicorn"):
        logging.getLogger(name).setLevel(level)
        logging.getLogger(name).handlers.clear()
    # It repeats each request, with its query.
    logging.getLogger("uvicorn.access").disabled = True
    for name in ("uvicorn.error", "asyncio"):
        logging.getLogger(name).filters[:] = [_Throttle()]


class _Throttle(logging.Filter):
    """Passes one record in ten seconds of each kind that a client can cause at will.

    Without it, connections beyond the descriptors fill a disk: asyncio logs 2,048 tracebacks a
    second for them.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._passed_at_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record is written."""
        event = str(record.msg)
        if event.startswith(_OF_STREAMS):
            return False
        kind = next((kind for kind in _CAUSED if event.startswith(kind)), None)
        if kind is None:
            return True
        now_s = self._clock()
        if now_s - self._passed_at_s.get(kind, -math.inf) < _THROTTLE_S:
            return False
        self._passed_at_s[kind] = now_s
        if kind == _NOT_TEXT:
            record.exc_info = None  # where in a library the client's bytes were found wrong
        return True


class LineFormatter(logging.Formatter):
    """Writes a record as one line of text, and a traceback below it, or as a JSON object."""

    def __init__(self, log_format: LogFormat) -> None:
        super().__init__()
        self._as_json = log_format is LogFormat.JSON

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, without keys and tokens."""
        at = datetime.fromtimestamp(record.created, UTC)
        facts: dict[str, Any] = {
            "time": at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage(),
        }
        if (request_id := current_id()) is not None:
            facts["request_id"] = request_id
        facts |= getattr(record, _FIELDS, {})
        traceback = self.formatException(record.exc_info) if record.exc_info else None
        if self._as_json:
            if traceback is not None:
                facts["traceback"] = traceback
            return without_keys(json.dumps(facts, default=str))
        words = [
            str(value) if name in _UNNAMED else f"{name}={value}" for name, value in facts.items()
        ]
        # A path may contain any character; a line break in one would start another line.
        lines = [" ".join(words), *([] if traceback is None else traceback.split("\n"))]
        return without_keys("\n".join(map(escaped, lines)))
