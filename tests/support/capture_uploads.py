"""Captures sent in parts, as a client does it."""

import io

import numpy as np

from tests.support.service import wait_for

URL = "/v1/maps/campus/drives/monday/captures"
KB = 2**10
SCANS = [np.random.default_rng(seed).normal(0, 9, (1800, 3)).astype("<f4") for seed in range(3)]


def parts_of(content: bytes, part_bytes: int) -> list[bytes]:
    return [content[at : at + part_bytes] for at in range(0, len(content), part_bytes)]


def begin(client, content: bytes, name: str = "monday.mcap", **other):
    files = [{"name": name, "size_bytes": len(content)}]
    begun = client.post(URL, json={"files": files, "part_bytes": 64 * KB, **other})
    assert begun.status_code in {200, 201}, begun.text
    return begun.json()


def put(client, capture, number: int, content: bytes, **headers):
    return client.put(
        f"{URL}/{capture['capture']}/parts/{number}", content=content, headers=headers
    )


def send(client, capture, content: bytes):
    for number, part in enumerate(parts_of(content, capture["part_bytes"])):
        assert put(client, capture, number, part).status_code == 201


def sent(client, content: bytes, name: str = "monday.mcap", **other):
    """Begin a capture and send all its parts."""
    capture = begin(client, content, name, **other)
    send(client, capture, content)
    return capture


def complete(client, capture, **other):
    return client.patch(f"{URL}/{capture['capture']}", json={"complete": True, **other})


def read(client, content: bytes, name: str = "monday.mcap", **other):
    """Send a capture, and return its job and itself when that has ended."""
    capture = sent(client, content, name, **other)
    answer = complete(client, capture)
    assert answer.status_code == 202, answer.text
    job = wait_for(client, answer.json()["job"])
    return job, client.get(f"{URL}/{capture['capture']}").json()


def stored_m(client, index: int):
    answer = client.get(f"/v1/maps/campus/drives/monday/scans/{index}")
    return np.load(io.BytesIO(answer.content))
