"""What a transport sends and opens, and which answers are none of the service."""

import asyncio
import json
import math
import ssl
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import httpx2
import numpy as np
import pytest
from tensormap_client import (
    Admin,
    ClientClosed,
    InvalidArgument,
    KeyWithoutTLS,
    Rejected,
    Unreachable,
    UnsupportedMap,
    Vehicle,
)
from tensormap_client._async.transport import AsyncTransport
from tensormap_client._sync import transport as module
from tensormap_client._sync.drive_requests import DriveRequests
from tensormap_client._sync.transport import Transport
from tensormap_client.io_sync import Stream
from tensormap_client.problems import MapNotFound

from tests.support.client_transport import OK, Clock, Service, problem, replace_clock


@pytest.fixture(autouse=True)
def clock(monkeypatch) -> Clock:
    return replace_clock(monkeypatch)


@pytest.fixture
def waited_s(clock) -> list[float]:
    """What the transport waited."""
    waited: list[float] = clock.waited_s
    return waited


class Dripping(httpx2.SyncByteStream, httpx2.AsyncByteStream):
    """A JSON object of which a byte comes every 50 ms, for four seconds if it is not closed."""

    def __iter__(self) -> Iterator[bytes]:
        for byte in b"{".ljust(79) + b"}":
            time.sleep(0.05)
            yield bytes([byte])

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for part in self:
            await asyncio.sleep(0.0)
            yield part


class Opened:
    """A stream, with what it was opened with, that counts how often it is closed."""

    def __init__(self, url: str, headers: object, tls: object, _timeout_s: float, **_by: object):
        self.url, self.headers, self.tls, self.closed = url, headers, tls, 0

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def opened(monkeypatch) -> list[Opened]:
    """What streams are opened from now on."""
    streams: list[Opened] = []

    def opened_one(*of_it: Any, **by: Any) -> Opened:
        streams.append(Opened(*of_it, **by))
        return streams[-1]

    monkeypatch.setattr(Stream, "open", opened_one)
    return streams


def test_an_empty_key_is_named_before_anything_is_sent() -> None:
    with pytest.raises(InvalidArgument, match="the key is empty"):
        Transport("http://maps.example", "", timeout_s=2.0, patience_s=0.0)


def test_a_request_has_the_key_and_lies_below_the_url() -> None:
    service = Service(OK)
    service.transport().request("GET", "/v1/maps")
    [request] = service.requests
    assert str(request.url) == "http://maps.example/under/v1/maps"
    assert request.headers["Authorization"] == "Bearer the-key"


def test_a_key_that_is_changed_is_that_of_the_next_attempt_and_of_the_next_stream(
    monkeypatch, opened
) -> None:
    service = Service(problem(503, "service-busy", "later"), OK, OK)
    transport = service.transport()
    monkeypatch.setattr(module, "sleep", lambda _: transport.set_key("another"))
    transport.request("GET", "/v1/maps", headers={"Accept": "text/plain"})
    transport.stream("/v1/x")
    transport.set_key(None)
    transport.request("GET", "/v1/maps")
    transport.stream("/v1/x")
    keys = [request.headers.get("Authorization") for request in service.requests]
    assert keys == ["Bearer the-key", "Bearer another", None]
    assert [stream.headers for stream in opened] == [{"Authorization": "Bearer another"}, {}]


@pytest.mark.parametrize("status", [200, 503])
@pytest.mark.parametrize("kind", [Transport, AsyncTransport])
def test_an_answer_that_drips_for_longer_than_the_timeout_is_none(kind, status) -> None:
    service = httpx2.MockTransport(lambda _: httpx2.Response(status, stream=Dripping()))
    transport = kind("http://maps.example", timeout_s=0.3, patience_s=0.0, connections=service)

    def ask() -> None:
        found = transport.json("GET", "/v1/maps")
        if kind is AsyncTransport:
            asyncio.run(found)

    begun_s = time.monotonic()
    with pytest.raises(Unreachable, match=r"cannot be reached: its answer took more than 0\.3 s"):
        ask()
    assert time.monotonic() - begun_s < 2.0


def test_a_download_takes_its_time() -> None:
    service = httpx2.MockTransport(lambda _: httpx2.Response(200, stream=Dripping()))
    transport = Transport("http://maps.example", timeout_s=0.3, patience_s=0.0, connections=service)
    assert len(transport.request("GET", "/v1/basis", is_download=True).content) == 80


def test_a_rejection_is_an_error_with_the_problem_and_is_not_repeated() -> None:
    service = Service(problem(404, "map-not-found", "there is no map 'campus'"))
    with pytest.raises(MapNotFound, match="404 map-not-found: there is no map 'campus'") as caught:
        service.transport().request("GET", "/v1/maps/campus")
    assert (caught.value.status, caught.value.problem) == (404, "map-not-found")
    assert len(service.requests) == 1


def test_an_answer_of_something_else_is_an_error_with_its_text() -> None:
    service = Service(httpx2.Response(404, text="<html>no such site</html>"))
    with pytest.raises(Rejected, match="404 <html>no such site"):
        service.transport().request("GET", "/v1/maps/campus")


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:8000",
        "maps.example",
        "ftp://maps.example",
        "http:",
        "http://maps.example?key=1",
        "http://maps.example/#docs",
        "http://maps.example:80000",
    ],
)
def test_what_is_no_url_is_rejected(url) -> None:
    with pytest.raises(InvalidArgument, match="is no URL of a service"):
        Transport(url, timeout_s=1.0, patience_s=1.0)


def test_streams_are_opened_at_the_url_of_the_requests_however_its_scheme_is_written(
    opened,
) -> None:
    for url in ("http://Maps.example", "HTTP://Maps.example/", "Https://Maps.example:444/under/"):
        Transport(url, timeout_s=1.0, patience_s=1.0).stream("/v1/x")
    assert [stream.url for stream in opened] == [
        "ws://Maps.example/v1/x",
        "ws://Maps.example/v1/x",
        "wss://Maps.example:444/under/v1/x",
    ]


@pytest.mark.parametrize("end", ["/v1", "/v1/", "/under/v1"])
def test_a_url_may_end_in_the_version_that_the_paths_begin_with(opened, end) -> None:
    service = Service(OK)
    transport = Transport(
        f"http://maps.example{end}",
        timeout_s=1.0,
        patience_s=1.0,
        connections=httpx2.MockTransport(service),
    )
    transport.request("GET", "/v1/maps")
    transport.stream("/v1/x")
    before = end.removesuffix("/").removesuffix("/v1")
    assert [str(request.url) for request in service.requests] == [
        f"http://maps.example{before}/v1/maps"
    ]
    assert [stream.url for stream in opened] == [f"ws://maps.example{before}/v1/x"]


def test_streams_trust_the_authorities_that_requests_trust(monkeypatch, opened) -> None:
    found, given = ssl.create_default_context(), ssl.create_default_context()
    monkeypatch.setattr(httpx2, "create_ssl_context", lambda: found)
    for url, tls in (("https", None), ("https", given), ("http", None), ("http", given)):
        Transport(f"{url}://maps.example", timeout_s=1.0, patience_s=1.0, tls=tls).stream("/v1/x")
    assert [stream.tls for stream in opened] == [found, given, None, None]


def test_a_password_in_a_url_is_not_in_messages() -> None:
    url = "http://fleet:pass@127.0.0.1:9/under"
    transport = Transport(url, timeout_s=1.0, patience_s=0.0)
    for ask in (transport.stream, lambda path: transport.request("GET", path)):
        with pytest.raises(Unreachable, match=r"(http|ws)://127\.0\.0\.1:9/under.* cannot be"):
            ask("/v1/maps")
    transport.close()
    with pytest.raises(ClientClosed, match=r"the client of http://127\.0\.0\.1:9/under is closed"):
        transport.stream("/v1/maps")
    with pytest.raises(InvalidArgument, match=r"'http://maps\.example\?a=1' is no URL"):
        Transport("http://fleet:pass@maps.example?a=1", timeout_s=1.0, patience_s=0.0)


@pytest.mark.parametrize(
    ("url", "key"),
    [
        ("http://[::1", None),
        ("http://host:abc", None),
        ("http://maps.example", "schlüssel"),
        ("http://maps.example", "two\nlines"),
        ("http://maps.example", "of-a-variable "),  # an error of the HTTP library would show it
    ],
)
def test_a_url_or_key_that_no_request_can_have_is_refused(url, key) -> None:
    with pytest.raises(InvalidArgument):
        Transport(url, key, timeout_s=2.0, patience_s=2.0)


def test_certificates_that_cannot_be_read_are_named_where_they_are_needed(
    tmp_path, monkeypatch
) -> None:
    empty = tmp_path / "certificates.pem"
    empty.touch()
    for path in (empty, tmp_path / "missing.pem"):
        monkeypatch.setenv("SSL_CERT_FILE", str(path))
        with pytest.raises(
            InvalidArgument, match=r"\(SSL_CERT_FILE, SSL_CERT_DIR\) cannot be read"
        ):
            Transport("https://maps.example", timeout_s=2.0, patience_s=2.0)
        Transport("http://maps.example", timeout_s=2.0, patience_s=2.0).close()


@pytest.mark.parametrize(
    ("timeout_s", "patience_s", "message"),
    [
        (0.0, 1.0, "timeout_s is 0.0, wanted above 0"),
        (-1.0, 1.0, "timeout_s is -1.0"),
        (math.nan, 1.0, "timeout_s is nan"),
        (math.inf, 1.0, r"timeout_s is inf, wanted above 0 and at most 1e\+06"),
        (1.0, -1.0, "patience_s is -1.0, wanted a float of 0 or more"),
        (1.0, math.nan, "patience_s is nan"),
    ],
)
def test_times_that_nothing_can_be_done_in_are_rejected(timeout_s, patience_s, message) -> None:
    with pytest.raises(InvalidArgument, match=message):
        Transport("http://maps.example", timeout_s=timeout_s, patience_s=patience_s)


def test_a_client_that_is_closed_while_it_waits_sends_nothing_more(monkeypatch) -> None:
    service = Service(problem(503, "service-busy", "later"))
    transport = service.transport()
    monkeypatch.setattr(module, "sleep", lambda _: transport.close())
    with pytest.raises(ClientClosed, match=r"the client of http://maps\.example/under is closed"):
        transport.request("GET", "/v1/maps")
    assert len(service.requests) == 1


def test_a_client_that_is_closed_closes_its_streams(monkeypatch, opened) -> None:
    transport = Service().transport()
    transport.stream("/v1/x")
    opens = Stream.open

    def opened_slowly(*of_it: Any, **by: Any) -> Stream:
        transport.close()
        return opens(*of_it, **by)

    monkeypatch.setattr(Stream, "open", opened_slowly)
    with pytest.raises(ClientClosed):
        transport.stream("/v1/x")
    assert [stream.closed for stream in opened] == [1, 1]


def test_another_web_server_is_no_service() -> None:
    page = httpx2.Response(200, html="<html>It works!</html>")
    with pytest.raises(Unreachable, match="no TensorMap service"):
        Service(page).transport().request("GET", "/v1/maps")
    for answer in ({"hello": "world"}, ["hello"], "hello"):
        other = Service(httpx2.Response(200, json=answer)).transport()
        with pytest.raises(Unreachable, match="no TensorMap service"):
            DriveRequests(other, "campus", "monday").stored()


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_a_redirection_is_no_answer_of_the_service_and_is_shown_and_not_followed(status) -> None:
    place = "https://hotspot.example/login"
    service = Service(httpx2.Response(status, headers={"Location": place}))
    with pytest.raises(Unreachable, match=f"POST /v1/maps: redirected to '{place}'"):
        service.transport().request("POST", "/v1/maps")
    assert len(service.requests) == 1


@pytest.mark.parametrize(
    "answer",
    [
        httpx2.Response(200, text="OK"),
        httpx2.Response(200, json=7),
        httpx2.Response(200, json={"status": "ok"}),
        httpx2.DecodingError("incorrect header check"),
    ],
)
def test_another_service_is_named_by_an_error_of_the_client(answer) -> None:
    connections = httpx2.MockTransport(Service(answer))
    with Admin("http://maps.example", connections=connections) as admin, pytest.raises(Unreachable):
        list(admin.maps())
    connections = httpx2.MockTransport(Service(answer))
    with (
        Vehicle("http://maps.example", None, "campus", connections=connections) as vehicle,
        pytest.raises((Unreachable, UnsupportedMap)),
    ):
        vehicle.locate([[1.0, 2.0, 3.0]])


@pytest.mark.parametrize(
    ("answer", "what"),
    [
        (httpx2.Response(200, json={"status": "ok"}), "15 bytes of application/json"),
        (httpx2.Response(200, content=b"OK"), "2 bytes of no type"),
        (httpx2.Response(304), "0 bytes of no type"),
    ],
)
def test_what_is_no_basis_is_of_no_service_and_named_by_its_length_and_type(answer, what) -> None:
    connections = httpx2.MockTransport(Service(answer))
    with (
        Vehicle("http://maps.example", None, "campus", connections=connections) as vehicle,
        pytest.raises(Unreachable, match=f"GET /v1/maps/campus/basis sent no basis, but {what}$"),
    ):
        vehicle.locate([[1.0, 2.0, 3.0]])


def test_numbers_and_arrays_of_numpy_are_sent_as_those_of_python() -> None:
    service = Service(OK, OK)
    transport = service.transport()
    parameters = {"segments": np.int64(5), "ranks": np.array([5, 6]), "share": np.float32(0.5)}
    transport.request("POST", "/v1/maps/a/builds", json=parameters)
    transport.request("POST", "/v1/x", params={"segment": np.array([1, 2]), "k": np.int64(3)})
    built, located = service.requests
    assert json.loads(built.content) == {"segments": 5, "ranks": [5, 6], "share": 0.5}
    assert built.headers["Content-Type"] == "application/json"
    assert located.url.query == b"segment=1&segment=2&k=3"


@pytest.mark.parametrize("value", [{1, 2}, float("nan"), object()])
def test_what_json_does_not_have_is_refused_before_anything_is_sent(value) -> None:
    service = Service()
    with pytest.raises(InvalidArgument, match="cannot be sent as JSON"):
        service.transport().request("POST", "/v1/maps/a/builds", json={"segments": value})
    assert not service.requests


def test_a_key_that_others_could_read_is_warned_of():
    with pytest.warns(KeyWithoutTLS, match=r"the key is sent to http://maps\.example without TLS"):
        client = Vehicle("http://user:password@maps.example", "a key", "campus")
    client.close()
    later = Vehicle("http://maps.example", None, "campus")
    with later, pytest.warns(KeyWithoutTLS):
        later.set_key("a key")


@pytest.mark.parametrize(
    "url",
    [
        "https://maps.example",
        "http://127.0.0.1:8000",
        "http://localhost:8000",
        "http://10.8.0.1:8000",
        "http://100.64.0.1",
        "http://[fd00::1]:8000",
        "http://tensormap:8000",
        "http://maps.internal",
    ],
)
def test_a_key_over_tls_or_in_a_private_network_is_not_warned_of(url):
    Vehicle(url, "a key", "campus").close()  # a warning would be an error
