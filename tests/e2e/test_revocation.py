"""A revoked key, through the real server: refused at once, by whichever process it was revoked."""

import json
import subprocess
import sys
import time

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.support.commands import ROOT
from tests.support.process import serving
from tests.support.recording import recording
from tests.support.service import upload, wait_for

ADMIN_KEY = "an-administrators-key"
REVOKE = """
import sys
from pathlib import Path
from storage.store import Store
store = Store(Path(sys.argv[1]), None)
store.keys.revoke(sys.argv[2])
store.close()
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("revocation")
    with serving(folder / "data", folder / "log", admin_key=ADMIN_KEY) as server:
        server.client.headers["Authorization"] = f"Bearer {ADMIN_KEY}"
        server.client.post("/v1/maps", json={"map": "campus"}).raise_for_status()
        upload(server.client, "monday", recording(scans=6))
        job = server.client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
        assert wait_for(server.client, job)["state"] == "done"
        yield server


def new_key(server):
    wanted = {"name": "vehicle", "scopes": ["localize", "maps:read"]}
    made = server.client.post("/v1/keys", json=wanted).json()
    return made["key"], {"Authorization": f"Bearer {made['secret']}"}


def status(server, headers):
    return server.client.get("/v1/maps/campus", headers=headers).status_code


def test_a_key_is_refused_from_the_answer_on_that_revoked_it(server):
    for _ in range(10):
        key, headers = new_key(server)
        assert [status(server, headers) for _ in range(3)] == [200] * 3
        assert server.client.delete(f"/v1/keys/{key}").status_code == 200
        assert status(server, headers) == 401


def test_a_key_that_another_process_revokes_is_refused_within_a_second(server):
    key, headers = new_key(server)
    assert [status(server, headers) for _ in range(3)] == [200] * 3
    data = server.log.parent / "data"
    command = [sys.executable, "-c", REVOKE, str(data), key]
    subprocess.run(command, check=True, timeout=60, cwd=ROOT)
    ended_s = time.monotonic()  # the commit was before
    asked_s = ended_s
    while status(server, headers) != 401:  # however long an answer takes on a busy machine
        assert asked_s - ended_s < 5  # it is one read; tests run beside it
        asked_s = time.monotonic()


def test_a_stream_ends_with_its_key(server):
    key, headers = new_key(server)
    track = server.client.post("/v1/maps/campus/tracks", headers=headers).json()["track"]
    url = f"ws://127.0.0.1:{server.port}/v1/maps/campus/tracks/{track}/stream"
    with connect(url, additional_headers=headers) as stream:
        stream.send("{}")
        assert json.loads(stream.recv())["type"] == "/problems/invalid-request"
        assert server.client.delete(f"/v1/keys/{key}").status_code == 200
        stream.send("{}")
        assert json.loads(stream.recv())["type"] == "/problems/key-refused"
        with pytest.raises(ConnectionClosed):
            stream.recv()
