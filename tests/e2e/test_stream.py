"""The stream of a track through the real server: its library, its limits, its refusals."""

import json
import math
import os
import socket
import struct
import subprocess
import sys

import numpy as np
import pytest
from tensormap_client import ClientClosed, TooFewCells, Vehicle
from tensormap_client.problems import StaleObservation
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from app.revisions.schemas import BasisOut
from app.tracking.answers import STEP, STREAM_PROTOCOL
from core.encodings.signature import pack_signatures
from tests.support.process import serving
from tests.support.recording import recording
from tests.support.service import upload, wait_for

TRACKS = "/v1/maps/campus/tracks"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stream")
    with serving(folder / "data", folder / "log") as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "monday", recording())
        body = {"segments": 2, "encoding": "harmonic", "views": "full"}
        job = server.client.post("/v1/maps/campus/builds", json=body).json()["job"]
        assert wait_for(server.client, job)["state"] == "done"
        yield server


@pytest.fixture
def url(server):
    track = server.client.post(TRACKS).json()["track"]
    return f"ws://127.0.0.1:{server.port}{TRACKS}/{track}/stream"


def test_packed_signatures_are_answered_one_by_one(server, url):
    basis = BasisOut.model_validate(server.client.get("/v1/maps/campus/basis").json()).to_core()
    with connect(url) as stream:
        for index in range(6):
            stream.send(pack_signatures(basis.encode(basis.image(recording().scans[index]))))
            answer = json.loads(stream.recv())
        assert (answer["observations"], answer["scan_index"], answer["localized"]) == (6, 5, True)
    log = server.log.read_text()
    assert "Traceback" not in log, log
    assert "Warning" not in log, log


def test_a_stream_of_packed_answers_has_64_bytes_a_message(server, url):
    basis = BasisOut.model_validate(server.client.get("/v1/maps/campus/basis").json()).to_core()
    with connect(url, subprotocols=[Subprotocol(STREAM_PROTOCOL)]) as stream:
        assert stream.subprotocol == STREAM_PROTOCOL
        for index in range(6):
            stream.send(pack_signatures(basis.encode(basis.image(recording().scans[index]))))
            answer = stream.recv()
            assert isinstance(answer, bytes)
            assert len(answer) == STEP.bytes == 64
    assert isinstance(answer, bytes)
    layout, flags, _, _, scan_index = struct.unpack_from("<BBHHI", answer)
    assert (layout, flags & 1, scan_index) == (1, 1, 5)


def test_a_stream_without_an_upgrade_is_426_over_a_kept_connection_too(server, url):
    for _ in range(2):
        refused = server.client.get(url.replace("ws:", "http:"))
        assert (refused.status_code, refused.headers["Upgrade"]) == (426, "websocket")


def test_a_vehicle_with_the_client_is_tracked_and_its_numbers_come_back(server):
    with Vehicle(f"http://127.0.0.1:{server.port}", None, "campus") as vehicle:
        track = vehicle.track()
        for index in range(6):
            points_m = recording().scans[index].points_m
            answer = track.observe(points_m, timestamp_s=7.0 + index, travelled_m=1.0)
            assert answer is not None
            assert (answer.sequence, answer.timestamp_s) == (index + 1, 7.0 + index)
        assert answer is not None
        assert (answer.localized, answer.scan_index) == (True, 5)
        with pytest.raises(StaleObservation):
            track.observe(points_m, timestamp_s=3.0)
        answer = track.observe(points_m, timestamp_s=20.0)
        assert answer is not None
        assert answer.sequence == 8
        track.close()


def test_a_track_of_a_closed_vehicle_goes_on_no_more(server):
    with Vehicle(f"http://127.0.0.1:{server.port}", None, "campus") as vehicle:
        track = vehicle.track()
        assert track.observe(recording().scans[0].points_m) is not None
    with pytest.raises(ClientClosed, match="closed: make another one"):
        track.observe(recording().scans[1].points_m)


FORKED = """
import os, sys
import numpy as np
from tensormap_client import ClientClosed, Vehicle

points_m = np.load(sys.argv[2])
with Vehicle(sys.argv[1], None, "campus") as vehicle, vehicle.track() as track:
    vehicle.locate(points_m)
    track.observe(points_m)
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        assert os.waitstatus_to_exitcode(status) == 0
        print(track.observe(points_m).observations)
    else:
        for use in (vehicle.locate, track.observe):
            try:
                print(use(points_m))
            except ClientClosed as error:
                print(error, flush=True)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_is_not_answered_by_its_parent_s_connections(server, tmp_path):
    np.save(tmp_path / "scan.npy", recording().scans[0].points_m)
    url = f"http://127.0.0.1:{server.port}"
    words = [sys.executable, "-c", FORKED, url, str(tmp_path / "scan.npy")]
    printed = subprocess.run(words, capture_output=True, check=True, encoding="utf-8").stdout
    refused = f"the client of {url} was made in another process: make one in each process"
    assert printed.splitlines() == [refused, refused, "2"]


def test_a_covered_scan_does_not_reach_the_track(server):
    with Vehicle(f"http://127.0.0.1:{server.port}", None, "campus") as vehicle:
        track = vehicle.track()
        for index in range(5):
            track.observe(recording().scans[index].points_m, travelled_m=1.0)
        points_m = recording().scans[5].points_m
        ahead = np.abs(np.arctan2(points_m[:, 1], points_m[:, 0])) < 0.1
        for scan in (points_m[ahead], points_m[ahead][::2]):
            with pytest.raises(TooFewCells):
                track.observe(scan, travelled_m=0.5)
        answer = track.observe(recording().scans[6].points_m, travelled_m=1.0)
        assert answer is not None
        assert (answer.sequence, answer.observations) == (8, 6)
        assert (answer.localized, answer.scan_index) == (True, 6)
        track.close()


def test_a_rejected_message_is_answered_with_its_number_and_time(server, url):
    body = struct.pack("<BQdd", 64, 5, 2.5, math.nan)
    with connect(url) as stream:
        for message in (body[:9], body + b"no signature", struct.pack("<BQdd", 64, 2**60, 0, 0)):
            stream.send(message)
            assert json.loads(stream.recv())["status"] == 422
        basis = BasisOut.model_validate(server.client.get("/v1/maps/campus/basis").json()).to_core()
        packed = pack_signatures(basis.encode(basis.image(recording().scans[3])))
        for status in (None, 409):
            stream.send(body + packed)
            answer = json.loads(stream.recv())
            assert (answer["sequence"], answer["timestamp_s"]) == (5, 2.5)
            assert answer.get("status") == status
        stream.send(packed)
        answer = json.loads(stream.recv())
        assert (answer["sequence"], answer["timestamp_s"]) == (None, None)
        assert last_sequence(stream) == "none"
    with connect(url) as again:
        assert last_sequence(again) == "5"


def last_sequence(stream):
    assert stream.response is not None
    return stream.response.headers["TensorMap-Last-Sequence"]


def test_a_message_beyond_the_limit_closes_the_stream(url):
    def send_and_wait(message):
        stream.send(message)
        stream.recv()

    with connect(url, max_size=None) as stream:
        with pytest.raises(ConnectionClosedError):
            send_and_wait(os.urandom(5 * 2**20))
        # It is closed as soon as the length is known: what is still on its way then may cost the
        # client the frame with the reason.
        assert stream.close_code in {1009, 1006}


def test_messages_are_not_compressed_though_a_client_offers_it(url):
    """4 kB could be 4 MB of zeros, times a thousand streams of one key."""
    with connect(url, compression="deflate") as stream:
        assert stream.request is not None
        assert "permessage-deflate" in stream.request.headers["Sec-WebSocket-Extensions"]
        assert stream.response is not None
        assert "Sec-WebSocket-Extensions" not in stream.response.headers


def test_a_message_of_endless_empty_parts_closes_the_stream(url):
    def send_and_wait():
        stream.send(b"" for _ in range(100_000))
        stream.recv()

    with connect(url) as stream:
        with pytest.raises(ConnectionClosedError):
            send_and_wait()
        assert stream.close_code in {1009, 1006}


def test_a_message_in_parts_is_answered_as_a_whole_one(url):
    with connect(url) as stream:
        stream.send([b"no ", b"", b"signature"])
        assert json.loads(stream.recv())["status"] == 422


def test_a_client_that_sends_pings_and_reads_no_pong_is_cut_off(server, url):
    """By itself the server would keep every pong in memory."""
    ping = b"\x89\xfd" + bytes(4 + 125)  # masked with zeros

    def send_many():
        sent = 0
        while sent < 64 * 2**20:
            sent += made.send(ping * 1000)

    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as made:
        made.sendall(
            f"GET {url.partition(str(server.port))[2]} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        assert made.recv(4096).startswith(b"HTTP/1.1 101 ")
        with pytest.raises(ConnectionError):
            send_many()
    assert "Traceback" not in server.log.read_text()


@pytest.mark.parametrize("headers", [{"Origin": "https://maps.example"}, {"Host": "maps.example"}])
def test_a_page_from_elsewhere_is_refused_before_the_stream_opens(url, headers):
    with (
        pytest.raises(InvalidStatus) as refused,
        connect(url, additional_headers=headers),
    ):
        pass
    assert refused.value.response.status_code in {400, 421}
    assert "Origin" not in headers or b"host-not-allowed" in (refused.value.response.body or b"")


def test_a_stream_of_an_unknown_track_is_rejected(server):
    none = f"ws://127.0.0.1:{server.port}{TRACKS}/none/stream"
    with pytest.raises(InvalidStatus) as refused, connect(none):
        pass
    assert refused.value.response.status_code == 404
