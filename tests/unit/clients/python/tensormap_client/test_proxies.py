"""A service on this machine is reached without the proxies that the environment names."""

import asyncio
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from tensormap_client import Admin, AsyncVehicle, InvalidArgument, Rejected, Unreachable, Vehicle
from tensormap_client.proxies import is_on_this_machine, proxy_of

PROXIES = ("http_proxy", "https_proxy", "all_proxy")
NO_PROXY_LISTENS = "http://127.0.0.1:9"


class _NotFound(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        self.send_error(404)

    def log_message(self, *_of_it: object) -> None:
        """Show nothing."""


@pytest.fixture
def url() -> Iterator[str]:
    """The URL of a service on this machine that has nothing."""
    with HTTPServer(("127.0.0.1", 0), _NotFound) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """An environment that names no proxy, and excepts no host from one."""
    for name in ("no_proxy", *PROXIES):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    return monkeypatch


@pytest.mark.parametrize("proxy", [NO_PROXY_LISTENS, "socks5://127.0.0.1:9", "no:port:at all"])
def test_requests_and_streams_to_this_machine_pass_by_any_proxy(
    url: str, proxy: str, environment: pytest.MonkeyPatch
) -> None:
    for name in PROXIES:
        environment.setenv(name, proxy)
    with Admin(url) as admin, pytest.raises(Rejected) as rejected:
        admin.map("campus")
    assert rejected.value.status == 404
    with Vehicle(url, None, "campus") as vehicle, pytest.raises(Rejected) as rejected:
        vehicle._transport.stream("/v1/stream")
    assert rejected.value.status == 404

    async def open_stream() -> None:
        async with AsyncVehicle(url, None, "campus") as vehicle:
            await vehicle._transport.stream("/v1/stream")

    with pytest.raises(Rejected):
        asyncio.run(open_stream())


@pytest.mark.parametrize("name", ["http_proxy", "all_proxy"])
@pytest.mark.parametrize("proxy", [NO_PROXY_LISTENS, NO_PROXY_LISTENS.removeprefix("http://")])
def test_other_hosts_are_reached_through_the_proxy(
    name: str, proxy: str, environment: pytest.MonkeyPatch
) -> None:
    environment.setenv(name, proxy)
    with Admin("http://maps.example") as admin:
        # The name of the host is never looked up.
        with pytest.raises(Unreachable, match=r"http://maps\.example cannot be reached: .*refused"):
            admin.map("campus")
        with pytest.raises(Unreachable, match=r"ws://maps\.example/v1/stream cannot .*refused"):
            admin._transport.stream("/v1/stream")


@pytest.mark.parametrize(
    ("url", "proxy"),
    [
        ("http://maps.example", "http://any:1"),
        ("https://maps.example/under", "http://secure:2"),
        ("https://maps.example:444", None),
        ("https://eu.yard.example", None),
        ("https://notyard.example", "http://secure:2"),
        ("http://10.1.2.3:8000", None),
        ("http://11.1.2.3:8000", "http://any:1"),
        ("http://[fd00::7]:8000", None),
        ("http://localhost:8000", None),
    ],
)
def test_requests_and_streams_have_one_proxy_but_to_the_hosts_of_no_proxy(
    url: str, proxy: str | None, environment: pytest.MonkeyPatch
) -> None:
    environment.setenv("https_proxy", "secure:2")
    environment.setenv("all_proxy", "http://any:1")
    environment.setenv("no_proxy", "maps.example:444, yard.example,10.0.0.0/8,fd00::/16")
    assert proxy_of(url) == proxy


@pytest.mark.parametrize(
    ("proxy", "why"), [("no:port:at all", "Invalid port"), ("socks5://127.0.0.1:9", "socks")]
)
def test_a_proxy_that_cannot_be_used_is_named(
    proxy: str, why: str, environment: pytest.MonkeyPatch
) -> None:
    environment.setenv("all_proxy", proxy)
    expected = rf"the environment names for http://maps\.example \(.*all_proxy\) .*: .*{why}"
    with pytest.raises(InvalidArgument, match=expected):
        Admin("http://maps.example")


@pytest.mark.parametrize(
    ("host", "here"),
    [
        ("127.0.0.1:8000", True), ("127.3.2.1", True), ("LOCALHOST", True), ("[::1]:8000", True),
        ("maps.example", False), ("192.0.2.1:8000", False), ("localhost.example", False),
    ],
)  # fmt: skip
def test_only_loopback_is_this_machine(host: str, here: bool) -> None:
    assert is_on_this_machine(f"http://{host}/under") is here
