"""One key holds uploads, closures, JSON, idle connections and WebSockets open, all at once.

Another key's signature fix is answered within half a second at the 99th percentile, on a connection
that is kept and on new ones.
"""

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tests.support.recording import recording
from tests.support.service import upload
from tests.torture.support.load import Answers, Request, as_json, ask_again_and_again
from tests.torture.support.service import Tortured, tortured
from tests.torture.support.sizes import seconds, size
from tests.torture.support.watching import watching
from tests.torture.support.writes import ended_job

pytestmark = [pytest.mark.torture, pytest.mark.alone]

MAP = "/v1/maps/campus"
P99_S = 0.5
SECONDS = seconds("TENSORMAP_TORTURE_STARVATION_S", 15.0)
UPLOADS, CLOSURES, JSONS = 200, 100, 4
IDLE = size("idle", 2000)
WEBSOCKETS = size("websockets", 5000)
_JSON_BYTES = 4 * 2**20 - 2**10
_ROOT = Path(__file__).parents[2]


@pytest.fixture
def service(tmp_path):
    with tortured(tmp_path) as running:
        with running.client() as client:
            client.post("/v1/maps", json={"map": "campus"}).raise_for_status()
            upload(client, "monday", recording())
            job = client.post(f"{MAP}/builds", json={"segments": 3}).json()["job"]
            assert ended_job(client, job)["state"] == "done"
        yield running


def key(client: httpx2.Client, *scopes: str) -> dict[str, str]:
    wanted = {"name": "a key", "scopes": scopes}
    made = client.post("/v1/keys", json=wanted).raise_for_status().json()
    return {"Authorization": f"Bearer {made['secret']}"}


def signature_fix(client: httpx2.Client, headers: dict[str, str]) -> Request:
    """Return a fix by a signature, as the map's basis makes it."""
    basis = client.get(f"{MAP}/basis").raise_for_status().json()
    rows, columns = len(basis["radial_basis"][0]), basis["parameters"]["ranks"][1]
    real = [[40.0 / (1 + i + j) for j in range(columns)] for i in range(rows)]
    signature = {"values_real": real, "values_imag": [[0.0] * columns] * rows}
    body = as_json({"basis": basis["basis"], "signatures": [signature]})
    sent = {**headers, "Content-Type": "application/json"}
    return Request("POST", f"{MAP}/localizations/signature", sent, body)


@contextmanager
def starved(service: Tortured, client: httpx2.Client) -> Iterator[None]:
    """Let a process of its own take all that one key can get, until the block ends."""
    headers = key(client, "maps:read", "maps:write", "localize")
    track = client.post(f"{MAP}/tracks", headers=headers).raise_for_status().json()["track"]
    pairs = [(i % 48, (i * 7 + 11) % 48) for i in range(100)]
    proposals = [{"first": _scan(first), "second": _scan(second)} for first, second in pairs]
    wanted: dict[str, Any] = {
        "path": MAP,
        "headers": headers,
        "track": track,
        "closures": {"proposals": proposals},
        "uploads": UPLOADS,
        "closing": CLOSURES,
        "bodies": JSONS,
        "json_bytes": _JSON_BYTES,
        "idle": IDLE,
        "websockets": WEBSOCKETS,
    }
    load = subprocess.Popen(
        [sys.executable, "-m", "tests.torture.support.starving", str(service.port)],
        cwd=_ROOT,
        env={**os.environ, "PYTHONPATH": str(_ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert load.stdin is not None
    assert load.stdout is not None
    try:
        load.stdin.write(json.dumps(wanted) + "\n")
        load.stdin.flush()
        assert load.stdout.readline() == "ready\n"
        yield
        load.stdin.write("\n")
        load.stdin.flush()
        print(load.stdout.readline())
    finally:
        load.kill()
        load.wait()
        load.stdin.close()
        load.stdout.close()


def _scan(index: int) -> dict[str, object]:
    return {"drive": "monday", "scan_index": index}


async def measured(port: int, request: Request) -> list[Answers]:
    """Return the answers on a kept connection and on new ones."""
    both = (ask_again_and_again(port, [request], seconds=SECONDS, kept=k) for k in (True, False))
    return list(await asyncio.gather(*both))


def test_a_fix_of_another_key_is_answered_in_time_whatever_one_key_holds_open(service):
    with service.client() as client:
        fix = signature_fix(client, key(client, "localize"))
        with starved(service, client), watching(service, every_s=0.25) as watch:
            answers = asyncio.run(measured(service.port, fix))
    for name, found in zip(("kept", "new"), answers, strict=True):
        print(f"{name}: {found}")
    for found in answers:
        assert set(found.statuses) == {200}, found
        assert found.quantile(0.99) < P99_S, found
    watch.require()
    assert service.log.stat().st_size < 10 * 2**20
    with service.client() as client:  # and once it lets go, it may come again
        client.get(MAP).raise_for_status()
