"""Why connections fail, in the words of messages."""

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tensormap_client import Unreachable
from tensormap_client._async.transport import AsyncTransport
from tensormap_client._sync.transport import Transport
from tensormap_client.causes import why


@pytest.fixture
def plain() -> Iterator[str]:
    """The address of a service that speaks plain HTTP: it answers any bytes by a status."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def answer() -> None:
            while True:
                try:
                    connection, _ = listening.accept()
                except OSError:
                    return
                with connection:
                    connection.recv(2000)
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")

        answering = threading.Thread(target=answer)
        answering.start()
        yield "127.0.0.1:{1}".format(*listening.getsockname())
        listening.shutdown(socket.SHUT_RDWR)
        answering.join()


def _asynchronously(url: str, act: Callable[[Any], Any]) -> None:
    async def main() -> None:
        transport = AsyncTransport(url, timeout_s=5.0, patience_s=0.0)
        try:
            await act(transport)
        finally:
            await transport.close()

    asyncio.run(main())


def _synchronously(url: str, act: Callable[[Any], Any]) -> None:
    transport = Transport(url, timeout_s=5.0, patience_s=0.0)
    try:
        act(transport)
    finally:
        transport.close()


@pytest.mark.parametrize("run", [_asynchronously, _synchronously])
@pytest.mark.parametrize(
    ("act", "failed"),
    [
        (lambda transport: transport.request("GET", "/v1/maps"), "https://{} cannot be reached"),
        (lambda transport: transport.stream("/v1/maps/s"), "wss://{}/v1/maps/s cannot be opened"),
    ],
)
def test_a_service_without_tls_is_named_so_where_https_was_wanted(plain, run, act, failed) -> None:
    with pytest.raises(Unreachable) as error:
        run(f"https://{plain}", act)
    assert str(error.value).startswith(
        f"{failed.format(plain)}: what answers there does not speak TLS: is it http:// in place of"
        " https://? ([SSL: "
    )


def test_other_causes_are_those_of_the_library() -> None:
    assert why(OSError("no route")) == "no route"
    assert why(TimeoutError()) == "TimeoutError()"
