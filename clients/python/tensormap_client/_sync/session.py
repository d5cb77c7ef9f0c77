# Made by make_sync.py: change _async instead.
"""The base of a vehicle, a mapper and an administrator: connections to one service."""

import ssl
from collections.abc import Iterator, Mapping
from typing import Any

import httpx2

from tensormap_client._sync.closable import Closable
from tensormap_client._sync.transport import Transport


class Session(Closable):
    """Connections to a service, until they are closed.

    Args:
        url: The service's URL, for example `https://maps.example`.
        key: The caller's API key; `None` if the service needs no key.
        timeout_s: How long to wait for an answer, and then for all of it, in seconds.
        patience_s: How long a failed request is retried, in seconds. Where the service has not
            answered this object before, a lost connection is not retried.
        tls: How to check the service's certificate, if not against the system's authorities.
        connections: HTTP transport to use instead of the network; streams do not use it.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        timeout_s: float = 120.0,
        patience_s: float = 300.0,
        tls: ssl.SSLContext | None = None,
        connections: httpx2.BaseTransport | None = None,
    ) -> None:
        self._transport = Transport(
            url,
            key,
            timeout_s=timeout_s,
            patience_s=patience_s,
            tls=tls,
            connections=connections,
        )

    def close(self) -> None:
        """Close all connections."""
        self._transport.close()

    def _get(self, path: str) -> Mapping[str, Any]:
        return dict(self._transport.json("GET", path))

    def _sent(
        self, method: str, path: str, json: object = None, *, repeats: bool = True
    ) -> Mapping[str, Any]:
        return dict(self._transport.json(method, path, json=json, repeats=repeats))

    def _pages(
        self, path: str, params: Mapping[str, Any] | None = None
    ) -> Iterator[Mapping[str, Any]]:
        """Yield the items of a list, page by page."""
        query = dict(params or {})
        while True:
            page = self._transport.json("GET", path, params=query)
            for item in page["items"]:
                yield item
            if page["next_after"] is None:
                return
            query["after"] = page["next_after"]
