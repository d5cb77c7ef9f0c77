"""Connections through the real server: bounded, idle ones closed first, late ones closed."""

import json
import socket
import time
from contextlib import suppress

import httpx2
import pytest

from tests.support.process import NO_TLS, serving, until

LIMIT = 12
HEAD = b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\n"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("connections")
    settings = {"max_connections": str(LIMIT), "request_head_s": "0.8"}
    with serving(folder / "data", folder / "log", **settings) as server:
        server.client.close()  # so that all there are is what a test opens
        yield server


@pytest.fixture
def opened(server):
    """Opens connections, and closes all at the end."""
    sockets = []

    def connect(sent=b""):
        made = socket.create_connection(("127.0.0.1", server.port), timeout=30)
        sockets.append(made)
        if sent:
            made.sendall(sent)
        return made

    yield connect
    for made in sockets:
        made.close()
    time.sleep(0.1)  # the server notices


def is_closed(made):
    """Return whether the server has closed a connection, without waiting for it."""
    made.setblocking(False)
    try:
        return made.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True
    finally:
        made.settimeout(30)


def answer_on(made):
    made.sendall(HEAD + b"\r\n")
    return received_json(made)


def received_json(made):
    answer = b""
    while not answer.endswith(b"}"):
        answer += (part := made.recv(4096))
        if not part:
            break
    return answer


def test_a_new_connection_is_answered_however_many_do_nothing(server, opened):
    idle = [opened() for _ in range(3 * LIMIT)]
    assert answer_on(opened()).startswith(b"HTTP/1.1 200")
    until(lambda: sum(map(is_closed, idle)) == len(idle) - LIMIT + 1, "they stay open")
    assert [is_closed(made) for made in idle] == sorted(
        (is_closed(made) for made in idle), reverse=True
    )


def test_head_answers_have_no_body_and_leave_the_connection_open(server, opened):
    made = opened()
    for path, status in (("/livez", 200), ("/docs", 200), ("/v1/maps/nowhere", 404)):
        made.sendall(f"HEAD {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += made.recv(1)
        assert head.startswith(f"HTTP/1.1 {status} ".encode())
        assert b"content-length: 0" not in head.lower()
    # A body would be read as the beginning of this answer.
    assert answer_on(made).startswith(b"HTTP/1.1 200")


def test_unused_connections_are_closed_before_those_kept_for_another_request(server, opened):
    kept = [opened() for _ in range(3)]
    assert all(answer_on(made).startswith(b"HTTP/1.1 200") for made in kept)
    idle = [opened() for _ in range(LIMIT - 3 + 5)]
    until(lambda: sum(map(is_closed, idle)) == 5, "none was closed")
    assert not any(map(is_closed, kept))
    assert all(answer_on(made).startswith(b"HTTP/1.1 200") for made in kept)


def test_where_all_are_in_use_another_is_refused_by_name(server, opened):
    body = b"POST /v1/maps HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    busy = [
        opened(body + b"Content-Length: 100\r\nExpect: 100-continue\r\n\r\n") for _ in range(LIMIT)
    ]
    for made in busy:  # once its head is read and its body waited for
        assert made.recv(4096).startswith(b"HTTP/1.1 100 ")
        made.sendall(b"{")
    refused = opened()
    answer = b""
    while part := refused.recv(4096):  # to its end: the connection is closed
        answer += part
    head, _, problem = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503 ")
    assert b"retry-after: 1" in head.lower()
    assert json.loads(problem)["type"] == "/problems/too-many-connections"
    assert not any(map(is_closed, busy))
    busy.pop().close()
    until(
        lambda: answer_on(opened()).startswith(b"HTTP/1.1 200"), "the room of one that ended stays"
    )


def test_where_refused_bodies_still_come_a_new_connection_is_answered(server, opened):
    """No key is needed to be refused, and a client may send its body for half a minute then."""
    refused = [
        opened(b"POST /nowhere HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100\r\n\r\n{")
        for _ in range(LIMIT)
    ]
    assert all(received_json(made).startswith(b"HTTP/1.1 404") for made in refused)
    assert answer_on(opened()).startswith(b"HTTP/1.1 200")
    assert is_closed(refused[0])


def test_where_no_client_reads_its_answer_a_new_connection_is_answered(server, opened):
    """No key is needed for the document of the API."""
    asked = b"GET /openapi.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    for _ in range(LIMIT):
        made = opened()
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        made.sendall(asked * 8)
    began = time.monotonic()
    until(lambda: answer_on(opened()).startswith(b"HTTP/1.1 200"), "all stay open")
    assert time.monotonic() - began < 60  # the system itself ends them after 120 s


@pytest.mark.parametrize("sent", [b"", b"GET /livez HTT", HEAD], ids=["none", "line", "field"])
def test_a_connection_that_sends_no_whole_head_is_closed(server, opened, sent):
    made = opened(sent)
    began = time.monotonic()
    assert made.recv(1) == b""
    assert time.monotonic() - began < 20  # of 0.8 s; uvicorn alone waits for ever


def test_a_head_that_comes_byte_by_byte_is_closed_too_on_a_kept_connection(server, opened):
    made = opened()
    assert answer_on(made).startswith(b"HTTP/1.1 200")
    for byte in b"GET /" + b"x" * 95:
        if is_closed(made):
            break
        with suppress(ConnectionError):
            made.sendall(bytes([byte]))
        time.sleep(0.2)
    else:
        pytest.fail("it stayed open for 20 s")


def test_a_slow_body_is_no_late_head(server, opened):
    made = opened(
        b"POST /v1/maps HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        b"Content-Length: 15\r\n\r\n"
    )
    for byte in b'{"map": "slow"}':
        made.sendall(bytes([byte]))
        time.sleep(0.1)  # 1.5 s in all, longer than a head may take
    assert made.recv(4096).startswith(b"HTTP/1.1 201")


def test_a_kept_connection_sends_many_requests(server):
    with httpx2.Client(base_url=f"http://127.0.0.1:{server.port}", verify=NO_TLS) as client:
        for _ in range(3):
            assert client.get("/livez").status_code == 200
            time.sleep(0.6)


@pytest.mark.parametrize(
    "head",
    [
        b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Long: " + b"x" * 2**17,
        b"GET /" + b"x" * 2**17,
        b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: maps.example\r\n\r\n",
        b"GET /livez HTTP/1.1\r\n\r\n",
        b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 20,
        b"POST /v1/maps HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 3\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        b"POST /v1/maps HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\n\r\n"
        b"GET /v1 HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n",
        b"CONNECT maps.example:80 HTTP/1.1\r\nHost: maps.example\r\n\r\n",
        b"CONNECT /v1/maps HTTP/1.1\r\nHost: maps.example\r\n\r\n",
    ],
    ids=[
        "long field",
        "long path",
        "two hosts",
        "no host",
        "many at once",
        "two lengths",
        "stream behind a request",
        "tunnel",
        "tunnel to a path",
    ],
)
def test_a_head_that_only_an_attacker_sends_is_refused(server, opened, head):
    made = opened(head)
    received = b""
    with suppress(ConnectionResetError):
        while part := made.recv(65536):
            received += part
    assert b"HTTP/1.1 400" in received


def test_what_cannot_be_parsed_as_a_request_is_in_the_log(server, opened):
    assert opened(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc").recv(64).startswith(b"HTTP/1.1 400")
    until(lambda: "Invalid HTTP request received. (" in server.log.read_text(), "nothing is logged")


@pytest.mark.parametrize(
    ("fields", "status", "reason"),
    [
        (b"Content-Length: 1\r\n", b"400", b"unsupported request body"),
        (b"Transfer-Encoding: chunked\r\n", b"400", b"transfer codings"),
        (b"".join(b"X-%d: 1\r\n" % n for n in range(140)), b"431", b"128 headers"),
    ],
    ids=["length", "chunks", "many fields"],
)
def test_a_request_for_a_websocket_that_is_malformed_is_answered_and_closed(
    opened, fields, status, reason
):
    made = opened(HEAD + b"Connection: Upgrade\r\nUpgrade: websocket\r\n" + fields + b"\r\n")
    received = b""
    while part := made.recv(65536):
        received += part
    assert received.startswith(b"HTTP/1.1 " + status)
    assert reason in received


ASKS_FOR_HTTP2 = (
    b"Host: 127.0.0.1\r\nConnection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\n"
    b"HTTP2-Settings: AAEAAEAAAAIAAAABAAMAAABkAAQBAAAAAAUAAEAA\r\n"
)


@pytest.mark.parametrize("later", [False, True], ids=["one segment", "two segments"])
def test_a_request_that_asks_for_http2_is_answered_as_another(opened, later):
    body = b'{"map": "%b"}' % (b"later" if later else b"at-once")
    head = b"POST /v1/maps HTTP/1.1\r\n" + ASKS_FOR_HTTP2
    head += b"Content-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(body)
    made = opened(head if later else head + body)
    if later:
        time.sleep(0.2)
        made.sendall(body)
    assert received_json(made).startswith(b"HTTP/1.1 201")
    assert answer_on(made).startswith(b"HTTP/1.1 200")


def test_a_body_is_never_the_next_request(opened):
    hidden = HEAD + b"\r\n"
    head = b"POST /v1/maps HTTP/1.1\r\n" + ASKS_FOR_HTTP2
    made = opened(head + b"Connection: close\r\nContent-Length: %d\r\n\r\n" % len(hidden))
    time.sleep(0.2)
    made.sendall(hidden)
    received = b""
    while part := made.recv(4096):
        received += part
    assert received.count(b"HTTP/1.1 ") == 1
    assert received.startswith((b"HTTP/1.1 415", b"HTTP/1.1 422"))


def test_trailers_without_an_end_are_refused(server, opened):
    made = opened(
        b"POST /v1/maps HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\nX-Trailer: "
    )
    received = b""
    with suppress(ConnectionError):
        made.sendall(b"x" * 2**18)
        while part := made.recv(65536):
            received += part
    assert b"HTTP/1.1 201" not in received


def test_full_of_connections_the_log_stays_short(server, opened):
    idle = [opened() for _ in range(3 * LIMIT)]
    until(lambda: any(map(is_closed, idle)), "none was closed")
    log = server.log.read_text()
    assert "connections is reached" in log
    assert "Traceback" not in log, log
    assert log.count("connections is reached") < 10
