"""Logs: one line an event, as text or as JSON; no key, no body and no query ever stands in one.

The standard library does it: docs/decisions/0020-operation.md says why.
"""

import json
import logging
import re
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, TextIO

from app.access.secrets import hidden
from app.http.context import current_id

_FIELDS = "tensormap_fields"
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
# What is said of each stream besides our own line: one repeats its query, and another takes a
# refusal for a fault.
_OF_STREAMS = (
    '%s - "WebSocket ',
    "connection open",
    "connection rejected",
    "connection closed",
    "ASGI callable returned without completing handshake.",
)
_CAUSED = (
    "socket.accept() out of system resource",
    "Invalid HTTP request received.",
    "Unsupported upgrade request.",
)
_SELDOM_S = 10.0


class LogFormat(StrEnum):
    """How a line is written."""

    TEXT = "text"
    JSON = "json"


def fields(**told: object) -> dict[str, Any]:
    """Return the `extra` of a record that tells these besides its event."""
    return {_FIELDS: told}


def configure_logging(
    log_format: LogFormat, level: str = "INFO", stream: TextIO | None = None
) -> None:
    """Write what this process logs to standard error, and nothing of it anywhere else."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(_JsonLine() if log_format is LogFormat.JSON else _TextLine())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    for name in ("tensormap", "uvicorn"):
        logging.getLogger(name).setLevel(level)
        logging.getLogger(name).handlers.clear()
    # It repeats each request, with its query.
    logging.getLogger("uvicorn.access").disabled = True
    for name in ("uvicorn.error", "asyncio"):
        log = logging.getLogger(name)
        log.filters[:] = [_Seldom()]


class _Seldom(logging.Filter):
    """Lets what any client can cause, as often as it likes, through once in a while.

    Without it, connections beyond the descriptors fill a disk: asyncio logs 2,048 tracebacks a
    second for them.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._let_through_at: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record is to be written."""
        event = str(record.msg)
        if event.startswith(_OF_STREAMS):
            return False
        kind = next((kind for kind in _CAUSED if event.startswith(kind)), None)
        if kind is None:
            return True
        now_s, last_s = self._clock(), self._let_through_at.get(kind)
        if last_s is not None and now_s - last_s < _SELDOM_S:
            return False
        self._let_through_at[kind] = now_s
        return True


class _Line(logging.Formatter):
    """What both formats tell."""

    def facts(self, record: logging.LogRecord) -> dict[str, Any]:
        """Return all but the traceback, in the order in which it is written."""
        at = datetime.fromtimestamp(record.created, UTC)
        facts: dict[str, Any] = {
            "time": at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage(),
        }
        if (request_id := current_id()) is not None:
            facts["request_id"] = request_id
        return facts | getattr(record, _FIELDS, {})

    def traceback(self, record: logging.LogRecord) -> str | None:
        """Return the traceback, if an error is told."""
        return self.formatException(record.exc_info) if record.exc_info else None


class _JsonLine(_Line):
    def format(self, record: logging.LogRecord) -> str:
        facts = self.facts(record)
        if (traceback := self.traceback(record)) is not None:
            facts["traceback"] = traceback
        return hidden(json.dumps(facts, default=str))


class _TextLine(_Line):
    def format(self, record: logging.LogRecord) -> str:
        facts = self.facts(record)
        head = [facts.pop(name) for name in ("time", "level", "logger", "event")]
        told = [f"{name}={value}" for name, value in facts.items()]
        # A path holds any character; a line break in one would begin a line of its own.
        line = _CONTROL.sub(lambda found: repr(found[0])[1:-1], " ".join(map(str, head + told)))
        traceback = self.traceback(record)
        return hidden(line if traceback is None else f"{line}\n{traceback}")
