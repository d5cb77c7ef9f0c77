"""One key takes all that it can get; another is answered on new connections, and builds next."""

import asyncio
import http.client
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import httpx2
import pytest

from tests.support.access import ADMIN_KEY, bearer
from tests.support.process import NO_TLS, ROOT, until
from tests.support.recording import recording
from tests.support.service import upload, wait_for
from tests.torture.support.crowds import idle_connections, open_websockets

TREE = Path(os.environ.get("TENSORMAP_TORTURE_TREE") or ROOT)
IDLE, WEBSOCKETS, TRACKS, BUILDS = 2000, 5000, 1000, 300
P99_S = 0.5
OTHER_LOG_BYTES = 10**5  # all but the lines of requests and streams, one each
MEASURED_S = float(os.environ.get("TENSORMAP_TORTURE_SHARES_S", "20"))
SOFT_DESCRIPTORS = 1024  # what a Linux system gives a program that does not ask for more
MAP = "/v1/maps/campus"


@dataclass
class Answers:
    """Statuses, and the seconds that each answer took on a connection of its own."""

    statuses: Counter[int] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)

    def p99_s(self) -> float:
        ordered = sorted(self.seconds) or [0.0]
        return ordered[min(int(len(ordered) * 0.99), len(ordered) - 1)]

    def __str__(self) -> str:
        return f"{dict(self.statuses)}, p99 {self.p99_s():.3f} s, most {max(self.seconds):.3f} s"


@contextmanager
def served(folder: Path) -> Iterator[tuple[int, Path]]:
    """Run `tensormap serve` as an operator does, with a soft limit as systems have it."""
    log = folder / "log"
    kept = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    with log.open("w") as written:
        process = subprocess.Popen(
            [
                *("prlimit", f"--nofile={SOFT_DESCRIPTORS}:{hard}"),
                *(sys.executable, "-m", "app.cli", "serve", "--port", "0"),
                *("--data", str(folder / "data")),
            ],
            cwd=TREE,
            env={**kept, "PYTHONPATH": str(TREE), "TENSORMAP_ADMIN_KEY": ADMIN_KEY},
            stdout=written,
            stderr=subprocess.STDOUT,
        )
    try:
        until(lambda: "startup complete" in log.read_text(), "the service did not start")
        url = next(w for w in log.read_text().split() if w.startswith("http://127.0.0.1:"))
        yield int(url.rpartition(":")[2]), log
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def ask(port: int, method: str, path: str, headers: dict[str, str], body: bytes) -> int:
    """Ask on a new connection and return the status, 0 if there is no answer within 5 s."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        answer.read()
    except (OSError, http.client.HTTPException):
        return 0
    else:
        return answer.status
    finally:
        connection.close()


@contextmanager
def measured(*request: object) -> Iterator[Answers]:
    """Ask again and again while the block runs, from a thread of its own."""
    answers, done = Answers(), threading.Event()

    def go_on() -> None:
        while not done.is_set():
            began = time.perf_counter()
            status = ask(*request)  # type: ignore[arg-type]
            answers.statuses[status] += 1
            answers.seconds.append(time.perf_counter() - began)
            done.wait(0.02)

    asking = threading.Thread(target=go_on)
    asking.start()
    try:
        yield answers
    finally:
        done.set()
        asking.join()


def client_of(port: int, secret: str) -> httpx2.Client:
    return httpx2.Client(
        base_url=f"http://127.0.0.1:{port}", timeout=60, verify=NO_TLS, headers=bearer(secret)
    )


def key_of(admin: httpx2.Client) -> str:
    wanted = {"name": "a key", "scopes": ["maps:read", "maps:write", "localize"]}
    secret: str = admin.post("/v1/keys", json=wanted).json()["secret"]
    return secret


def signature_of(client: httpx2.Client) -> bytes:
    basis = client.get(f"{MAP}/basis").json()
    ranks = len(basis["radial_basis"][0]), basis["parameters"]["ranks"][1]
    real = [[40.0 / (1 + i + j) for j in range(ranks[1])] for i in range(ranks[0])]
    zeros = [[0.0] * ranks[1]] * ranks[0]
    signatures = [{"values_real": real, "values_imag": zeros}]
    return json.dumps({"basis": basis["basis"], "signatures": signatures}).encode()


def started_between(jobs: list[dict[str, str]], first: datetime, last: datetime) -> int:
    begun = (datetime.fromisoformat(job["started_at"]) for job in jobs if job["started_at"])
    return sum(first < at < last for at in begun)


def all_jobs(client: httpx2.Client) -> list[dict[str, str]]:
    jobs: list[dict[str, str]] = []
    after = ""
    while True:
        page = client.get("/v1/jobs", params={"after": after, "limit": 100}).json()
        jobs += page["items"]
        if page["next_after"] is None:
            return jobs
        after = page["next_after"]


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # thousands of sockets are cut off
def test_a_key_that_takes_all_it_can_get_leaves_the_others_theirs(tmp_path):
    with served(tmp_path) as (port, log), client_of(port, ADMIN_KEY) as admin:
        admin.post("/v1/maps", json={"map": "campus"})
        upload(admin, "monday", recording())
        build = {"segments": 3}
        assert wait_for(admin, admin.post(f"{MAP}/builds", json=build).json()["job"])
        greedy_key, other_key = key_of(admin), key_of(admin)
        with client_of(port, greedy_key) as greedy, client_of(port, other_key) as other:
            fix = signature_of(other)
            tracks = [greedy.post(f"{MAP}/tracks") for _ in range(TRACKS)]
            queued = Counter(
                greedy.post(f"{MAP}/builds", json=build).status_code for _ in range(BUILDS)
            )
            track = tracks[0].json()["track"]

            asked = f"{MAP}/localizations/signature"
            headers = {**bearer(other_key), "Content-Type": "application/json"}
            found: dict[str, tuple[Answers, Answers]] = {}

            @contextmanager
            def phase(name: str) -> Iterator[None]:
                with (
                    measured(port, "POST", asked, headers, fix) as fixes,
                    measured(port, "GET", "/livez", {}, b"") as alive,
                ):
                    yield
                print(f"{name}: fixes {fixes}; livez {alive}")
                found[name] = fixes, alive

            async def attack() -> None:
                stream = f"{MAP}/tracks/{track}/stream"
                with phase("builds only"):
                    await asyncio.sleep(MEASURED_S / 2)
                async with idle_connections(port, IDLE) as idle:
                    with phase(f"{IDLE} idle connections besides"):
                        await asyncio.sleep(MEASURED_S)
                    with phase(f"{WEBSOCKETS} WebSockets asked for besides"):
                        streams = open_websockets(port, stream, bearer(greedy_key), WEBSOCKETS)
                        websockets = await streams.__aenter__()
                    print(f"WebSockets: {dict(websockets.answers)}")
                    with phase("those that were accepted besides"):
                        await asyncio.sleep(MEASURED_S)
                    await streams.__aexit__(None, None, None)
                    print(f"{idle.closed} idle connections were closed")

            asyncio.run(attack())
            theirs = other.post(f"{MAP}/tracks").status_code
            job = other.post(f"{MAP}/builds", json=build).json()["job"]
            done = wait_for(other, job, {"running", "done"})
            queued_at, started_at = (
                datetime.fromisoformat(done[moment]) for moment in ("created_at", "started_at")
            )
            between = started_between(all_jobs(admin), queued_at, started_at)
        lines = log.read_text().splitlines()
        other_bytes = sum(len(line) for line in lines if " tensormap.requests " not in line)
        figures = (
            f"tracks of the greedy key {dict(Counter(t.status_code for t in tracks))},"
            f" of the other {theirs}\n"
            f"builds of the greedy key {dict(queued)}, started before the other's: {between}\n"
            f"log {log.stat().st_size / 1e6:.2f} MB, {other_bytes / 1e6:.3f} MB not of requests"
        )
        print(figures)
    for fixes, alive in found.values():
        assert set(fixes.statuses) == set(alive.statuses) == {200}
        assert max(fixes.p99_s(), alive.p99_s()) < P99_S
    assert theirs == 201
    assert between == 0
    assert other_bytes < OTHER_LOG_BYTES
