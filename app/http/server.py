"""The server that listens: how many connections it has, and how many wait to be accepted."""

import logging
import resource
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import uvicorn

from app.http.connection_slots import ConnectionSlots
from app.http.connections import BoundedConnection
from app.http.web_sockets import BoundedWebSocket
from app.process import collect_seldom
from app.settings import Settings

_log = logging.getLogger("tensormap.connections")

_MOST_BY_DEFAULT = 4096  # more take memory (some 20 KB each), not descriptors
_SPARE_DESCRIPTORS = 512  # for files, the catalog's pool, builds, and connections being accepted
_BACKLOG = 2048  # connections that wait to be accepted; Uvicorn's own default
_ACCEPTED_AT_ONCE = 64  # before the loop does anything else; each takes a descriptor
_UNREAD_S = 120  # that a peer may receive nothing of an answer


def within_descriptors(settings: Settings) -> Settings:
    """Return the settings with as many connections and streams as this process can have open.

    The soft limit of descriptors is raised to the hard one. Half of the connections may be streams,
    half of these of one key: streams that a client never closes leave room for others.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(OSError, ValueError):  # some systems allow less than the hard limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    endless = soft == resource.RLIM_INFINITY
    room = _MOST_BY_DEFAULT if endless else max(soft - min(_SPARE_DESCRIPTORS, soft // 2), 8)
    connections = settings.max_connections or min(room, _MOST_BY_DEFAULT)
    if connections > room and not endless:
        _log.warning(
            "%d descriptors allow %d connections, not %d: raise `ulimit -n`",
            soft,
            room,
            connections,
        )
        connections = room
    streams = max(min(settings.max_streams, connections // 2), 1)
    chosen = {
        "max_connections": connections,
        "max_streams": streams,
        "max_streams_per_key": max(min(settings.max_streams_per_key, streams // 2), 1),
    }
    return settings.model_copy(update=chosen)


def connection_options(settings: Settings) -> dict[str, Any]:
    """Return the options of Uvicorn's `Config` that bound connections.

    Args:
        settings: The settings from `within_descriptors`.
    """
    slots = ConnectionSlots(settings.max_connections)
    limits = {"slots": slots, "head_s": settings.request_head_s}
    protocol = type("BoundedProtocol", (BoundedConnection,), limits)
    return {
        "loop": "uvloop",
        "http": protocol,
        "ws": BoundedWebSocket,
        "backlog": _ACCEPTED_AT_ONCE,
    }


def close_unread(listening: socket.socket) -> None:
    """Let the system end connections whose peer receives nothing of an answer for two minutes."""
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; accepted connections inherit it
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_S * 1000)


class BoundedServer(uvicorn.Server):
    """A server that accepts a few connections at a time and lets many wait.

    asyncio uses `backlog` for both.

    Args:
        config: Of Uvicorn.
        stopping: Called on the event loop when the server begins to stop: it ends answers that
            would last longer than a stop waits for them.
    """

    def __init__(self, config: uvicorn.Config, stopping: Callable[[], None] = lambda: None) -> None:
        super().__init__(config)
        self._stopping = stopping

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, with a longer queue; everything loaded by then is excluded from collection."""
        await super().startup(sockets)
        collect_seldom()
        for listening in sockets or ():
            listening.listen(_BACKLOG)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop: wait for the answers that are left."""
        self._stopping()
        await super().shutdown(sockets)
