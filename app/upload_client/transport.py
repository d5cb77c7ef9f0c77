"""Requests to a service that may be repeated, until they are answered.

This module uses nothing else of this product but its errors.
"""

import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import httpx2

from app.upload_client.errors import Rejected, Unreachable, UploadFailed

PATIENCE_S = 300.0
"""For so long one request is repeated: a service that restarts, or a limit that is reached."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 15.0
_TIMEOUT = httpx2.Timeout(120.0, connect=10.0)
_TRANSIENT = frozenset({408, 429, 502, 503, 504})
_MOST_CHARACTERS = 500


class Transport:
    """Connections to one service; its methods are safe from several threads.

    Args:
        url: Of the service, as `https://maps.example`.
        key: Sent as `Authorization: Bearer`, if given.
        patience_s: How long a request is repeated once the service has answered any.
        wait: Waits so many seconds.
        connections: Instead of those over the network.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        patience_s: float = PATIENCE_S,
        wait: Callable[[float], None] = time.sleep,
        connections: httpx2.BaseTransport | None = None,
    ) -> None:
        parts = urlsplit(url)
        if parts.scheme not in {"http", "https"} or not parts.netloc:
            raise UploadFailed(f"{url!r} is no URL of a service, as http://127.0.0.1:8000")
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self._url, self._patience_s, self._wait = url, patience_s, wait
        self._client = httpx2.Client(
            base_url=url, headers=headers, timeout=_TIMEOUT, transport=connections
        )
        self._answered = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._client.close()

    def request(
        self,
        method: str,
        path: str,
        *,
        content: bytes | None = None,
        json: object = None,
        params: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> httpx2.Response:
        """Send a request that may be repeated, and return its answer.

        Lost connections and answers 408, 429, 502, 503 and 504 are followed by another attempt,
        after `Retry-After` where the service sends it.

        Raises:
            Unreachable: If the first request gets no answer, or a later one none for `patience_s`.
            Rejected: If the service rejects it.
        """
        deadline = time.monotonic() + self._patience_s
        wait_s = _FIRST_WAIT_S
        while True:
            failure: UploadFailed
            asked_s = 0.0
            try:
                answer = self._client.request(
                    method, path, content=content, json=json, params=params, headers=headers
                )
            except httpx2.TransportError as error:
                failure = Unreachable(f"{self._url} cannot be reached: {error or repr(error)}")
                failure.__cause__ = error
                if not self._answered:
                    raise failure from error
            else:
                self._answered = True
                if answer.is_success:
                    return answer
                failure = _rejection(f"{method} {path}", answer)
                if answer.status_code not in _TRANSIENT:
                    raise failure
                asked_s = _seconds(answer.headers.get("Retry-After", ""))
            pause_s = max(wait_s, asked_s)
            if time.monotonic() + pause_s > deadline:
                raise failure
            self._wait(pause_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)


def _rejection(request: str, answer: httpx2.Response) -> Rejected:
    try:
        problem = answer.json()
        kind = str(problem["type"]).rpartition("/")[2]
        detail = str(problem["detail"])
    except (ValueError, KeyError, TypeError):
        kind, detail = "", answer.text[:_MOST_CHARACTERS] or answer.reason_phrase
    message = f"{request}: {answer.status_code} {kind}: {detail}".replace(" : ", " ")
    return Rejected(message, answer.status_code, kind, detail)


def _seconds(text: str) -> float:
    return float(text) if text.isdecimal() else 0.0
