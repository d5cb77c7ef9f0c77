"""One key takes all that it can get; another is answered in time, and gets its share.

The load comes from a process of its own: where the one that measures holds thousands of sockets
too, its own delay is measured. The bar is for two cores that do nothing else; where the machine is
slow before the attack, a multiple of what an answer took then. Each figure has the machine's load
beside it.
"""

import asyncio
import os
import resource
import time
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import httpx2
import pytest

from tests.support.recording import recording
from tests.support.service import upload, wait_for
from tests.torture.support.load import Answers, Request, as_json, send_repeatedly
from tests.torture.support.service import Tortured, tortured
from tests.torture.support.sizes import seconds, size
from tests.torture.support.starving import greedy
from tests.torture.support.watching import watching

pytestmark = [pytest.mark.torture, pytest.mark.alone]

MAP = "/v1/maps/campus"
JSON = {"Content-Type": "application/json"}
P99_S = 0.5
BURST_P99_S = 1.0  # while thousands of handshakes, or megabytes of JSON, are worked on beside that
CALM, MOST_CALM_TIMES = "nothing else", 20
SECONDS = seconds("TENSORMAP_TORTURE_STARVATION_S", 4.0)
FEWEST_ANSWERS, MOST_S = 100, 30.0
UPLOADS, CLOSURES, IDLE, BODIES = 200, 100, 2000, 8
WEBSOCKETS = size("websockets", 1500)
TRACKS, BUILDS = size("tracks", 520), size("builds", 60)
OTHER_LOG_BYTES = 10**5  # all but the lines of requests and streams, one each
BODY_BYTES = 4 * 2**20 - 2**10
SOFT_DESCRIPTORS = 1024  # what a Linux system gives a program that does not request more
WIDE_SCOPES = ("maps:read", "maps:write", "localize")


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with a built map and a soft limit of descriptors as systems have it."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    within = ("prlimit", f"--nofile={SOFT_DESCRIPTORS}:{hard}")
    with tortured(tmp_path_factory.mktemp("starvation"), within=within) as running:
        with running.client() as client:
            client.post("/v1/maps", json={"map": "campus"}).raise_for_status()
            upload(client, "monday", recording())
            assert wait_for(client, build(client))["state"] == "done"
        yield running


def build(client: httpx2.Client) -> str:
    answer = client.post(f"{MAP}/builds", json={"segments": 3}).raise_for_status()
    job: str = answer.json()["job"]
    return job


def key(service: Tortured, *scopes: str) -> dict[str, str]:
    with service.client() as client:
        made = client.post("/v1/keys", json={"name": "a key", "scopes": scopes}).raise_for_status()
    return {"Authorization": f"Bearer {made.json()['secret']}"}


def signature_fix(service: Tortured) -> Request:
    """Return a fix by a signature of another key, as the map's basis makes it."""
    with service.client() as client:
        basis = client.get(f"{MAP}/basis").raise_for_status().json()
    rows, columns = len(basis["radial_basis"][0]), basis["parameters"]["ranks"][1]
    real = [[40.0 / (1 + i + j) for j in range(columns)] for i in range(rows)]
    signature = {"values_real": real, "values_imag": [[0.0] * columns] * rows}
    body = as_json({"basis": basis["basis"], "signatures": [signature]})
    headers = {**JSON, **key(service, "localize")}
    return Request("POST", f"{MAP}/localizations/signature", headers, body)


def closure_proposals() -> list[dict[str, Any]]:
    pairs = [(i % 48, (i * 7 + 11) % 48) for i in range(100)]
    return [{"first": scan(first), "second": scan(second)} for first, second in pairs]


def scan(index: int) -> dict[str, object]:
    return {"drive": "monday", "scan_index": index}


@dataclass
class Table:
    """How long answers took, in each phase of an attack.

    Attributes:
        port: Of the service.
        fix: What another key requests.
        rows: The answers to it, and of `/livez`.
        bars: Seconds that 99 of 100 answers may take, of each phase.
    """

    port: int
    fix: Request
    rows: dict[str, Answers] = field(default_factory=dict)
    bars: dict[str, float] = field(default_factory=dict)

    def measure(
        self, phase: str, *, p99_s: float = P99_S, until: "Future[str] | None" = None
    ) -> None:
        """Send requests for `SECONDS` or until something is done, and until there is a p99."""
        self.bars[phase] = p99_s
        began = time.monotonic()
        self._send(phase, SECONDS if until is None else 1.0)
        while not (until is None or until.done()) or (
            self._fewest(phase) < FEWEST_ANSWERS and time.monotonic() < began + MOST_S
        ):
            self._send(phase, 1.0)
        for row, answers in self.rows.items():
            if row.startswith(phase):
                print(f"{row}: {answers} (load {os.getloadavg()[0]:.1f})")

    def _fewest(self, phase: str) -> int:
        return min(len(found.seconds) for row, found in self.rows.items() if row.startswith(phase))

    def _send(self, phase: str, for_s: float) -> None:
        alive = Request("GET", "/livez")
        requests = {
            f"{phase}: fixes, one connection": (self.fix, True),
            f"{phase}: fixes, new connections": (self.fix, False),
            f"{phase}: /livez, new connections": (alive, False),
        }

        async def answered() -> list[Answers]:
            sending = (
                send_repeatedly(self.port, [request], seconds=for_s, kept=kept)
                for request, kept in requests.values()
            )
            return list(await asyncio.gather(*sending))

        for row, answers in zip(requests, asyncio.run(answered()), strict=True):
            self.rows.setdefault(row, Answers()).extend(answers)

    def require(self) -> None:
        """Require that all was answered, and in time."""
        for row, answers in self.rows.items():
            assert set(answers.statuses) == {200}, (row, answers.statuses)
            phase, _, what = row.partition(": ")
            calm_s = self.rows[f"{CALM}: {what}"].quantile(0.99)
            most_s = max(1.0, MOST_CALM_TIMES * calm_s / P99_S) * self.bars[phase]
            assert answers.quantile(0.99) < most_s, f"{row}: {answers}, calm {calm_s:.3f} s"


def test_a_fix_of_another_key_is_answered_in_time_whatever_one_key_holds_open(service):
    table = Table(service.port, signature_fix(service))
    headers = key(service, *WIDE_SCOPES)
    with service.client() as client:
        begun = client.post(f"{MAP}/tracks", headers=headers).raise_for_status()
    with (
        greedy(service.port, MAP, headers) as attack,
        watching(service, every_s=0.25) as watch,
        ThreadPoolExecutor(1) as waiting,
    ):
        table.measure(CALM)
        attack.hold("idle", count=IDLE)
        attack.hold("uploads", count=UPLOADS)
        attack.hold("closures", count=CLOSURES, proposals=closure_proposals())
        time.sleep(2)
        table.measure(f"{UPLOADS} uploads, {CLOSURES} closures, {IDLE} idle connections")
        attack.begin("websockets", count=WEBSOCKETS, track=begun.json()["track"])
        opened = waiting.submit(attack.wait)
        burst = f"and {WEBSOCKETS} WebSockets requested"
        table.measure(burst, p99_s=BURST_P99_S, until=opened)
        table.measure("and those that were accepted")
        attack.hold("bodies", count=BODIES, length=BODY_BYTES)
        table.measure(f"and {BODIES} of 4 MB of JSON", p99_s=BURST_P99_S)
    print(f"grown by {watch.grown_bytes / 2**20:.0f} MB, /livez at most {watch.longest_s:.2f} s")
    table.require()
    watch.require()
    assert log_bytes_besides_requests(service) < OTHER_LOG_BYTES


def test_tracks_and_builds_of_another_key_do_not_wait_for_those_of_a_greedy_one(service):
    with (
        service.client() as admin,
        client_of(service) as greedy_client,
        client_of(service) as other,
    ):
        tracks = Counter(greedy_client.post(f"{MAP}/tracks").status_code for _ in range(TRACKS))
        parameters = {"segments": 3}
        builds = Counter(
            greedy_client.post(f"{MAP}/builds", json=parameters).status_code for _ in range(BUILDS)
        )
        theirs = other.post(f"{MAP}/tracks").status_code
        done = wait_for(other, build(other), {"running", "done"})
        between = started_between(
            all_jobs(admin), moment(done["created_at"]), moment(done["started_at"])
        )
        print(f"tracks of the greedy key {dict(tracks)}, of the other {theirs}")
        print(f"builds of the greedy key {dict(builds)}, begun before the other's: {between}")
    assert theirs == 201
    assert tracks[201], "the greedy key has no track"
    assert builds[202] > 1, "the greedy key has no builds that wait"
    assert between == 0
    assert log_bytes_besides_requests(service) < OTHER_LOG_BYTES


def client_of(service: Tortured) -> httpx2.Client:
    secret = key(service, *WIDE_SCOPES)["Authorization"].removeprefix("Bearer ")
    return service.client(secret)


def moment(text: str) -> datetime:
    return datetime.fromisoformat(text)


def started_between(jobs: list[dict[str, str]], first: datetime, last: datetime) -> int:
    return sum(first < moment(job["started_at"]) < last for job in jobs if job["started_at"])


def all_jobs(client: httpx2.Client) -> list[dict[str, str]]:
    jobs: list[dict[str, str]] = []
    after: str | None = ""
    while after is not None:
        page = client.get("/v1/jobs", params={"after": after, "limit": 100}).json()
        jobs += page["items"]
        after = page["next_after"]
    return jobs


def log_bytes_besides_requests(service: Tortured) -> int:
    lines = service.log.read_text().splitlines()
    return sum(len(line) for line in lines if " tensormap.requests " not in line)
