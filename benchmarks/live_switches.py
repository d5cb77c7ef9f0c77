"""A thousand switches of the live revision while eight clients query.

    python -m benchmarks.live_switches

A real service on a free port of this machine. Bar: no request fails, every answer is the one that
the revision it names gives alone, and an answer to a scan is of the revision that it reports as
live.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import numpy as np

from app.revisions.schemas import BasisOut
from benchmarks.timing import machine
from core.encodings.signature import pack_signatures
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

SWITCHES, CLIENTS = 1000, 8
SCANS = 48
KITTI = {"Content-Type": "application/vnd.tensormap.kitti"}
PACKED = {"Content-Type": "application/vnd.tensormap.signature"}
MAP = "/v1/maps/campus"


def main() -> int:
    """Print how many answers each revision gave; return 1 if one was not true."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data", folder]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ
        ) as service:
            try:
                return _switch(_url(service))
            finally:
                service.send_signal(signal.SIGTERM)
                threading.Thread(target=service.communicate, daemon=True).start()


def _url(service: subprocess.Popen[str]) -> str:
    assert service.stdout is not None  # noqa: S101 - it was requested
    for line in service.stdout:
        for word in line.split():
            if word.startswith("http://127.0.0.1:"):
                threading.Thread(target=service.stdout.read, daemon=True).start()
                return word.rstrip("/.,)")
    raise SystemExit("the service did not start")


def _switch(url: str) -> int:
    client = httpx2.Client(base_url=url, timeout=60)
    scan = _mapped(client)
    revisions = [r["revision"] for r in client.get(f"{MAP}/revisions").json()["items"]]
    alone: dict[tuple[str, str], Any] = {}
    signatures: dict[str, bytes] = {}
    for revision in revisions:
        client.put(f"{MAP}/live", json={"revision": revision}).raise_for_status()
        basis = BasisOut.model_validate(client.get(f"{MAP}/basis").json()).to_core()
        signatures[revision] = pack_signatures(basis.encode(basis.image(scan)))
        alone["scan", revision] = _query(client, "scan", _body(scan))["matches"]
        alone["signature", revision] = _query(client, "signature", signatures[revision])["matches"]
    done = threading.Event()

    def keep_querying(number: int) -> Counter[str]:
        counts: Counter[str] = Counter()
        with httpx2.Client(base_url=url, timeout=60) as own:
            while not done.is_set():
                answer = _query(own, "scan", _body(scan))
                of = answer["revision"]
                true = of == answer["live_revision"] and answer["matches"] == alone["scan", of]
                counts["scan" if true else "untrue"] += 1
                expected = revisions[(number + counts.total()) % 2]
                answer = _query(own, "signature", signatures[expected])
                true = (
                    answer["revision"] == expected
                    and answer["matches"] == alone["signature", expected]
                )
                counts["signature" if true else "untrue"] += 1
        return counts

    begun = time.perf_counter()
    with ThreadPoolExecutor(CLIENTS) as pool:
        querying = [pool.submit(keep_querying, number) for number in range(CLIENTS)]
        try:
            for switch in range(SWITCHES):
                body = {"revision": revisions[switch % 2]}
                client.put(f"{MAP}/live", json=body).raise_for_status()
        finally:
            done.set()
        counts = sum((one.result() for one in querying), Counter())
    seconds = time.perf_counter() - begun
    print(
        f"{SWITCHES} switches in {seconds:.0f} s: {counts['scan']} answers to scans,"
        f" {counts['signature']} to signatures, {counts['untrue']} of them untrue; {machine()}"
    )
    return int(counts["untrue"] > 0)


def _mapped(client: httpx2.Client) -> Scan:
    """Make a map of two revisions, and return a scan to query with."""
    drive = SimulatedDrive(seed=1, scans=SCANS, sensor=SimulatedSensor(firings=180))
    client.post("/v1/maps", json={"map": "campus"}).raise_for_status()
    for index in range(SCANS):
        path = f"{MAP}/drives/monday/scans/{index}"
        client.put(path, content=_body(drive.scan(index)), headers=KITTI).raise_for_status()
    for body in ({"segments": 3}, {"segments": 2, "reducer": "mean"}):
        job = client.post(f"{MAP}/builds", json=body).raise_for_status().json()
        while job["state"] in {"queued", "running"}:
            time.sleep(0.1)
            job = client.get(f"/v1/jobs/{job['job']}").json()
        if job["state"] != "done":
            raise SystemExit(f"a build ended as {job['state']}")
    return SimulatedDrive(
        seed=1, scans=SCANS, noise_seed=7, sensor=SimulatedSensor(firings=180)
    ).scan(4)


def _body(scan: Scan) -> bytes:
    return bytes(np.pad(scan.points_m, ((0, 0), (0, 1))).astype("<f4").tobytes())


def _query(client: httpx2.Client, kind: str, body: bytes) -> dict[str, Any]:
    headers = KITTI if kind == "scan" else PACKED
    answer = client.post(f"{MAP}/localizations/{kind}", content=body, headers=headers)
    content: dict[str, Any] = answer.raise_for_status().json()
    return content


if __name__ == "__main__":
    sys.exit(main())
