"""A load whose requests fail has no figures: it ends the benchmark."""

import socket
import threading

import pytest

from benchmarks import large_bodies
from benchmarks.http_load import NotAnswered, most_per_s, request


@pytest.fixture
def failing():
    """The port of a service that answers the first request only, and the others with 503."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        statuses = [b"503 Unavailable", b"200 OK"]

        def answer(connection):
            with connection:
                while connection.recv(2**16):
                    status = statuses.pop() if len(statuses) > 1 else statuses[0]
                    connection.sendall(b"HTTP/1.1 " + status + b"\r\ncontent-length: 0\r\n\r\n")

        def accept():
            while True:
                try:
                    connection, _ = listening.accept()
                except OSError:
                    return  # closed
                threading.Thread(target=answer, args=(connection,), daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        yield listening.getsockname()[1]
        listening.shutdown(socket.SHUT_RDWR)


def test_a_request_that_fails_in_a_thread_fails_the_measurement(failing):
    with pytest.raises(NotAnswered, match="503"):
        most_per_s(failing, [request("GET", "/livez")], clients=2, seconds=60.0)


def test_times_of_a_failing_service_are_not_returned(failing):
    with pytest.raises(NotAnswered, match="503"):
        large_bodies._timed(failing, [request("GET", "/livez")], seconds=0.0)


def test_a_percentile_of_few_answers_is_none():
    with pytest.raises(NotAnswered, match="5 answers"):
        large_bodies._rows("alone", [1.0] * 5, [1.0] * large_bodies.FEWEST)


@pytest.mark.parametrize("counts", [{}, {401: 900}, {200: 9, 429: 1}, {0: 3, 200: 9}])
def test_a_load_of_which_not_all_is_answered_as_it_should_be_is_none(counts):
    answers = [counts.get(status, 0) for status in range(600)]
    with pytest.raises(NotAnswered, match="scans of 64 MiB"):
        large_bodies._answered("scans of 64 MiB", answers)
