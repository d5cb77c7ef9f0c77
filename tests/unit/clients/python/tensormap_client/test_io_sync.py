"""Workers and streams of the synchronous client."""

import socket
import threading
from concurrent.futures import CancelledError

import pytest
from tensormap_client import Unreachable
from tensormap_client.io_sync import Stream, Work, Workers, sleep

LONG_S = 20.0


class Waiting:
    """Work that waits as between two attempts."""

    def __init__(self) -> None:
        self.begun = threading.Event()
        self.ended: list[str] = []

    def __call__(self) -> None:
        self.begun.set()
        try:
            sleep(LONG_S)
        except CancelledError:
            self.ended.append("cancelled")
            raise
        self.ended.append("waited")


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_block_waits_for_nobody(end) -> None:
    waiting, queued = Waiting(), Waiting()
    begun: list[Work[None]] = []

    def interrupted() -> None:
        with Workers(1) as workers:
            begun.extend((workers.start(waiting), workers.start(queued)))
            waiting.begun.wait()
            raise end

    with pytest.raises(end):
        interrupted()
    for work in begun:
        with pytest.raises(CancelledError):
            work.result()
    assert (waiting.ended, queued.ended) == (["cancelled"], [])


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_block_does_not_wait_for_a_request_on_its_way(end) -> None:
    begun, answered = threading.Event(), threading.Event()

    def request() -> bool:
        begun.set()
        return answered.wait(LONG_S)

    def interrupted() -> None:
        with Workers(1) as workers:
            works.append(workers.start(request))
            begun.wait()
            raise end

    works: list[Work[bool]] = []
    with pytest.raises(end):
        interrupted()
    answered.set()
    assert works[0].result()


def test_the_first_failure_ends_the_waiting_of_the_others() -> None:
    waiting = Waiting()

    def fail() -> None:
        waiting.begun.wait()
        raise OSError("rejected")

    def failing() -> None:
        with Workers(2) as workers:
            first = workers.start(waiting)
            workers.start(fail)
            first.result()

    with pytest.raises(OSError, match="rejected"):
        failing()
    assert waiting.ended == ["cancelled"]


def test_a_block_that_ends_waits_for_its_work() -> None:
    with Workers(2) as workers:
        works = [workers.start(pow, 2, number) for number in range(5)]
    assert [work.result() for work in works] == [1, 2, 4, 8, 16]


def test_a_stream_that_is_redirected_is_unreachable_and_nothing_is_sent_to_the_other_host() -> None:
    with socket.create_server(("127.0.0.1", 0)) as front, socket.create_server(("", 0)) as other:
        elsewhere = f"ws://localhost:{other.getsockname()[1]}/x"
        lines = "HTTP/1.1 307 Temporary Redirect", f"Location: {elsewhere}", "Content-Length: 0"

        def redirect() -> None:
            connection, _ = front.accept()
            with connection:
                connection.recv(4096)
                connection.sendall("\r\n".join([*lines, "", ""]).encode())

        thread = threading.Thread(target=redirect)
        thread.start()
        url = f"ws://127.0.0.1:{front.getsockname()[1]}/stream"
        with pytest.raises(Unreachable, match="redirected to 'ws://localhost"):
            Stream.open(url, {"Authorization": "Bearer secret"}, None, 2.0, proxy=None)
        thread.join()
        other.setblocking(False)
        with pytest.raises(BlockingIOError):  # nobody connected
            other.accept()
