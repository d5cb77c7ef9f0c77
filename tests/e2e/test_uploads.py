"""A thousand scans by eight clients at once, over connections that are cut."""

import random
import signal
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import httpx2
import numpy as np
import pytest

from storage.files.drive_chunks import scan_digest
from storage.store import Store
from tests.support.catalog_rows import stored_scans
from tests.support.process import NO_TLS, serving
from tests.support.recording import NPY, TAR, npy, tar

SCANS, CLIENTS, RETURNS = 1000, 8, 100
DRIVE = "/v1/maps/campus/drives/monday"


def points(index: int) -> np.ndarray:
    """Return the returns of a scan that no other scan has."""
    return np.random.default_rng(index).normal(scale=20, size=(RETURNS, 3)).astype(np.float32)


def archive(indices: list[int]) -> bytes:
    return tar((f"{index:06}.npy", npy(points(index))) for index in indices)


def cut_off(port: int, chance: random.Random, method: str, path: str, body: bytes) -> None:
    """Send a request up to some byte of its body, perhaps all, and go away without an answer."""
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {len(body)}\r\n"
    [kind] = (NPY if method == "PUT" else TAR).values()
    request = f"{head}Content-Type: {kind}\r\n\r\n".encode() + body
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(request[: chance.randint(1, len(request))])
        if chance.random() < 0.5:  # a reset, not an end
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")


@pytest.fixture
def server(tmp_path):
    with serving(tmp_path / "data", tmp_path / "log") as server:
        server.client.post("/v1/maps", json={"map": "campus"})
        yield server


class Fleet:
    """Eight vehicles; each uploads its share and some of its neighbour's."""

    def __init__(self, server) -> None:
        self.server = server
        self.cuts = 0
        self.count = threading.Lock()

    def drive(self, number: int) -> None:
        chance = random.Random(number)
        share = SCANS // CLIENTS
        mine = [(number * share + i) % SCANS for i in range(share + 10)]
        chance.shuffle(mine)
        url = f"http://127.0.0.1:{self.server.port}"
        with httpx2.Client(base_url=url, timeout=60, verify=NO_TLS) as client:
            while missing := self.missing(client, mine):
                batch = missing[: chance.randint(1, 60)]
                if len(batch) == 1:
                    path = f"{DRIVE}/scans/{batch[0]}"
                    method, body = "PUT", npy(points(batch[0]))
                else:
                    path, method, body = f"{DRIVE}/scans", "POST", archive(batch)
                if chance.random() < 0.4:
                    cut_off(self.server.port, chance, method, path, body)
                    with self.count:
                        self.cuts += 1
                    continue
                headers = NPY if method == "PUT" else TAR
                answer = client.request(method, path, content=body, headers=headers)
                assert answer.status_code in {200, 201}, answer.text
                if method == "POST":
                    result = answer.json()
                    assert result["files_set_aside"] == 0, result
                    assert result["scans_stored"] + result["scans_present"] == len(batch)

    @staticmethod
    def missing(client: httpx2.Client, expected: list[int]) -> list[int]:
        response = client.get(f"{DRIVE}/scans")
        if response.status_code == 404:
            return expected
        present = [(r["first"], r["last"]) for r in response.json()["present"]]
        return [i for i in expected if not any(first <= i <= last for first, last in present)]


def test_a_thousand_scans_by_eight_clients_over_cut_connections_are_a_thousand_scans(server):
    fleet = Fleet(server)
    with ThreadPoolExecutor(CLIENTS) as clients:
        for done in [clients.submit(fleet.drive, number) for number in range(CLIENTS)]:
            done.result()
    assert fleet.cuts > 10
    listed = server.client.get(f"{DRIVE}/scans").json()
    assert (listed["scans"], listed["present"]) == (SCANS, [{"first": 0, "last": SCANS - 1}])
    assert listed["gaps"] == []
    log = server.log.read_text()
    assert "Traceback" not in log, log[-3000:]
    server.end(signal.SIGTERM)
    data_dir = server.log.parent / "data"
    assert not list(data_dir.rglob("*.part"))
    assert_bit_for_bit(data_dir)


def assert_bit_for_bit(data_dir: Path) -> None:
    """Require each scan on disk to be what was sent, each file opened once."""
    with Store(data_dir) as store:
        records = stored_scans(store, "campus", "monday")
    assert [record.index for record in records] == list(range(SCANS))
    files = {path.name: path for path in data_dir.rglob("chunks/*.h5")}
    assert set(files) == {record.chunk for record in records}
    for name, path in files.items():
        with h5py.File(path) as file:
            stored, starts = file["points_m"][:], file["scan_start"][:]
        for record in records:
            if record.chunk == name:
                came = stored[starts[record.row] : starts[record.row + 1]]
                assert came.tobytes() == points(record.index).tobytes()
                assert record.digest == scan_digest(came)
