# Made by make_sync.py: change _async instead.
"""Requests to a service, retried until they are answered."""

import os
import ssl
import time
import warnings
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit
from weakref import WeakSet

import httpx2

from tensormap_client._sync.connections import limit_body, timed_connections
from tensormap_client.answers import JsonObject
from tensormap_client.causes import why
from tensormap_client.checks import require_key, require_patience, require_timeout
from tensormap_client.errors import (
    ClientClosed,
    ClientError,
    InvalidArgument,
    KeyWithoutTLS,
    Rejected,
    Unreachable,
)
from tensormap_client.io_sync import Stream, read, sleep
from tensormap_client.plain import json_body, query
from tensormap_client.problems import TooManyConnections
from tensormap_client.proxies import proxy_of
from tensormap_client.rejections import redirection, rejection
from tensormap_client.urls import is_private, require_url, service_url, shown
from tensormap_client.waits import LONGEST_ASKED_S, Waits

_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 15.0
_CONNECT_S = 10.0
_LONGEST_TIMEOUT_S = 1e6  # sockets take no infinite one, and on some systems not 25 days


class Transport:
    """Connections to one service.

    A key for a service over plain HTTP beyond private networks is warned of, as `KeyWithoutTLS`.

    Args:
        url: The service's URL, for example `https://maps.example`.
        key: The API key, sent as `Authorization: Bearer`, if given.
        timeout_s: How long to wait for an answer, and then for all of it, in seconds.
        patience_s: How long a failed request is retried, in seconds, if the service has answered
            one before.
        tls: How to check the service's certificate, if not against the system's authorities.
        connections: HTTP transport to use instead of the network; streams do not use it.

    Attributes:
        key_changes: How often it was given a key: a stream that was opened before has another one.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        timeout_s: float,
        patience_s: float,
        tls: ssl.SSLContext | None = None,
        connections: httpx2.BaseTransport | None = None,
    ) -> None:
        require_url(url)
        require_timeout(timeout_s, _LONGEST_TIMEOUT_S)
        require_patience(patience_s)
        # With the scheme in lower case, which `stream` replaces by that of WebSockets.
        self._url = service_url(url)
        self._shown = shown(self._url)
        self._timeout_s, self._patience_s = timeout_s, patience_s
        self.key_changes = 0
        # Whoever gives a transport of its own knows where it leads.
        self._warns_of_key = connections is None and _is_open(self._url)
        self.set_key(key)
        self._proxy = proxy_of(self._url)
        authorities = _authorities(url) if tls is None else tls
        # Streams trust whom requests trust; without TLS they take no context.
        self._tls = authorities if self._url.startswith("https:") else None
        try:
            self._client = httpx2.Client(
                base_url=self._url,
                timeout=httpx2.Timeout(timeout_s, connect=min(timeout_s, _CONNECT_S)),
                transport=(
                    timed_connections(authorities, self._proxy)
                    if connections is None
                    else connections
                ),
                trust_env=False,
            )
        except (ImportError, ValueError, httpx2.InvalidURL) as error:
            raise InvalidArgument(
                f"the proxy that the environment names for {self._shown} (http_proxy, https_proxy,"
                f" all_proxy) cannot be used: {error}"
            ) from error
        self._process = os.getpid()
        self._answered = False
        self._streams: WeakSet[Stream] = WeakSet()

    def set_key(self, key: str | None) -> None:
        """Take a key, or none, for all later requests and streams; from any thread.

        Raises:
            InvalidArgument: If no request can have it.
        """
        require_key(key)
        if key is not None and self._warns_of_key:
            warnings.warn(
                f"the key is sent to {self._shown} without TLS, so others can read it: use https",
                KeyWithoutTLS,
                stacklevel=2,
            )
        # Replaced, not changed: a request in another thread has the one or the other.
        self._headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self.key_changes += 1

    def close(self) -> None:
        """Close all connections and streams; later requests and streams raise `ClientClosed`.

        In a process that was forked meanwhile it does nothing: they are those of its parent.
        """
        if os.getpid() != self._process:
            return
        self._client.close()
        for stream in list(self._streams):
            stream.close()

    def request(
        self,
        method: str,
        path: str,
        *,
        content: bytes | None = None,
        json: object = None,
        params: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        patience_s: float | None = None,
        repeats: bool = True,
        is_download: bool = False,
    ) -> httpx2.Response:
        """Send a request, and return its answer.

        Lost connections and answers 408, 429, 502, 503 and 504 are followed by another attempt, the
        last one when the patience ends. It waits for as long as the service asks by `Retry-After`,
        and does not wait if that is longer than the patience; a proxy's is limited to half a
        minute.

        Args:
            method: The HTTP method.
            path: The path below the service's URL.
            content: The body.
            json: The body as JSON, in place of `content`.
            params: The query parameters.
            headers: Headers in addition to the key's.
            patience_s: How long a failed request is retried, if not as long as the transport's.
            repeats: Whether to send it again where the first one may have been done; otherwise only
                after 429 and `too-many-connections`, which answer before anything is begun.
            is_download: Whether the answer may be large: the timeout is then of each part of it.

        Raises:
            InvalidArgument: If JSON has no such value.
            ClientClosed: If `close` was called, also between two attempts, or in another process.
            Unreachable: If the transport's first request gets no answer, or a later one none for
                `patience_s`, or another kind of service answers.
            Rejected: If the service rejects the request; the subclass gives the reason.
        """
        headers, params = dict(headers or {}), params and query(params)
        if json is not None:
            content, headers["Content-Type"] = json_body(json), "application/json"
        patience_s = self._patience_s if patience_s is None else patience_s
        deadline_s, is_last = time.monotonic() + patience_s, False
        waits = Waits(_FIRST_WAIT_S, _LONGEST_WAIT_S)
        while True:
            self.require_open()
            failure: ClientError
            asked_s = 0.0
            try:
                with self._client.stream(
                    method, path, content=content, params=params, headers=self._headers | headers
                ) as answer:
                    within_s = None if is_download else self._timeout_s
                    limit_body(answer, within_s)
                    read(answer, within_s)
            except httpx2.RequestError as error:
                failure = Unreachable(f"{self._shown} cannot be reached: {why(error)}")
                failure.__cause__ = error
                if not (self._answered and repeats):
                    raise failure from error
            else:
                self._answered = True
                rejected = self._rejected(f"{method} {path}", answer)
                if rejected is None:
                    return answer
                if not (rejected.is_passing and (repeats or _is_before_any_act(rejected))):
                    raise rejected
                failure, asked_s = rejected, rejected.retry_after_s
                if not rejected.problem:  # a proxy's page: the service may be back long before
                    asked_s = min(asked_s, LONGEST_ASKED_S)
                elif time.monotonic() + asked_s > deadline_s:
                    raise rejected
            left_s = deadline_s - time.monotonic()
            if is_last or left_s <= 0.0:
                raise failure
            pause_s = waits.next_s(asked_s)
            is_last = pause_s >= left_s
            sleep(min(pause_s, left_s))

    def _rejected(self, request: str, answer: httpx2.Response) -> Rejected | None:
        """Return why the service rejects a request, `None` if it does not.

        Raises:
            Unreachable: If another kind of service answers.
        """
        if answer.is_success or answer.status_code == httpx2.codes.NOT_MODIFIED:
            if answer.headers.get("Content-Type", "").startswith("text/html"):
                raise Unreachable(f"{self._shown} is no TensorMap service: it sent a page")
            return None
        if answer.has_redirect_location:
            raise redirection(request, answer.headers)
        return rejection(request, answer.status_code, answer.content, answer.headers)

    def json(self, method: str, path: str, **options: Any) -> JsonObject:  # noqa: ANN401
        """Send a request, and return the JSON object of its answer.

        Args:
            method: The HTTP method.
            path: The path below the service's URL.
            options: Those of `request`, such as `params`.

        Raises:
            Unreachable: As `request`, and if the answer is not a JSON object.
            Rejected: If the service rejects the request; the subclass gives the reason.
        """
        answer = self.request(method, path, **options)
        try:
            return JsonObject(f"{method} {self._shown}{path}", answer.json())
        except (ValueError, TypeError) as error:
            raise Unreachable(
                f"{self._shown} is no TensorMap service: {method} {path} was answered by no object"
            ) from error

    def stream(self, path: str) -> Stream:
        """Open a WebSocket.

        Raises:
            ClientClosed: If `close` was called, or in another process.
            Unreachable: If the service does not answer in time.
            Rejected: If it rejects the stream.
        """
        self.require_open()
        url = "ws" + self._url.removeprefix("http") + path
        stream = Stream.open(url, self._headers, self._tls, self._timeout_s, proxy=self._proxy)
        self._streams.add(stream)
        if self._client.is_closed:  # meanwhile
            stream.close()
        self.require_open()
        return stream

    def require_open(self) -> None:
        """Reject a use after `close`, or in another process.

        A forked process has the same connections: it would read the answers to its parent.

        Raises:
            ClientClosed: If it is one.
        """
        if os.getpid() != self._process:
            raise ClientClosed(
                f"the client of {self._shown} was made in another process: make one in each process"
            )
        if self._client.is_closed:
            raise ClientClosed(f"the client of {self._shown} is closed: make another one")


def _is_open(url: str) -> bool:
    return url.startswith("http:") and not is_private(url)


def _authorities(url: str) -> ssl.SSLContext:
    """Return the check of the certificate of a service, against the system's authorities.

    Raises:
        InvalidArgument: If the environment names others, which cannot be read.
    """
    if urlsplit(url).scheme == "http":
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # never used: to read them takes 40 ms
    try:
        return httpx2.create_ssl_context()
    except OSError as error:
        raise InvalidArgument(
            "the certificates that the environment names (SSL_CERT_FILE, SSL_CERT_DIR) cannot be"
            f" read: {error}"
        ) from error


def _is_before_any_act(rejected: Rejected) -> bool:
    # Not so 408, 502 and 504 of a proxy, nor 503 of a service that stops or whose storage fails.
    return rejected.status == httpx2.codes.TOO_MANY_REQUESTS or isinstance(
        rejected, TooManyConnections
    )
