# Made by make_sync.py: change _async instead.
"""The base of a vehicle, a mapper and an administrator: connections to one service."""

import ssl
from collections.abc import Iterator, Mapping
from typing import Any

import httpx2

from tensormap_client._sync.closable import Closable
from tensormap_client._sync.transport import Transport
from tensormap_client.answers import Answer


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

    def set_key(self, key: str | None) -> None:
        """Take another key, or none, from the next request on, as before a token ends.

        Tracks go on under it: a stream is opened again with its next scan. It may be called from
        another thread or task than the other methods, and is not awaited.

        Raises:
            InvalidArgument: If no request can have it; the earlier one stays.
        """
        self._transport.set_key(key)

    def close(self) -> None:
        """Close all connections."""
        self._transport.close()

    def _get(self, path: str, params: Mapping[str, Any] | None = None) -> Answer:
        return dict(self._transport.json("GET", path, params=params))

    def _sent(
        self,
        method: str,
        path: str,
        json: object = None,
        *,
        params: Mapping[str, Any] | None = None,
        repeats: bool = True,
    ) -> Answer:
        answer = self._transport.json(method, path, json=json, params=params, repeats=repeats)
        return dict(answer)

    def _deleted(self, path: str, *, purge: bool = False) -> None:
        """Delete a resource; a second time it would be 404, as if there had been none."""
        params = {"purge": "true"} if purge else None
        self._transport.request("DELETE", path, params=params, repeats=False)

    def _pages(
        self,
        path: str,
        params: Mapping[str, Any] | None = None,
        *,
        items: str = "items",
        after: str = "after",
    ) -> Iterator[Answer]:
        """Yield the items of a list, page by page.

        Args:
            path: The list's path.
            params: The query of the first page.
            items: The field of a page that has its items.
            after: The parameter that `next_<after>` of a page is for.
        """
        query = dict(params or {})
        while True:
            page = self._transport.json("GET", path, params=query)
            for item in page[items]:
                yield item
            if page[f"next_{after}"] is None:
                return
            query[after] = page[f"next_{after}"]
