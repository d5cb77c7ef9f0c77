"""How the data directory of a release was made, with what its service answered.

In the worktree of this test: `PYTHONPATH=WORKTREE_OF_THE_RELEASE python tests/upgrade/make.py
RELEASE.tar.xz`: the service that runs is the release's own. A released directory is never made
again: a new release adds its own.
"""

import hashlib
import json
import sys
import tarfile
import tempfile
import time
from pathlib import Path

import numpy as np

from core.scans.scan import Scan
from storage.store import Store
from tests.support.recording import KITTI, Recording, kitti, recording
from tests.support.service import running, upload, wait_for

ADMIN_KEY = "correct horse battery staple"
ADMIN = {"Authorization": f"Bearer {ADMIN_KEY}"}
PATHS = (
    "/v1/maps",
    "/v1/maps/campus",
    "/v1/maps/campus/drives",
    "/v1/maps/campus/drives/monday/scans",
    "/v1/maps/campus/revisions",
    "/v1/maps/campus/topology",
    "/v1/maps/depot",
    "/v1/maps/depot/drives",
    "/v1/maps/depot/revisions",
    "/v1/keys",
    "/v1/audit?limit=1000",
)
DOWNLOADS = ("/v1/maps/campus/drives/monday/scans/3", "/v1/maps/campus/drives/tuesday/scans/1")
RETURNS = 250


def small(scans: int, noise_seed: int = 0) -> Recording:
    """Return the first scans of the recording, with few returns each."""
    chosen = np.random.default_rng(1)
    return Recording(
        tuple(
            Scan(
                chosen.permutation(scan.points_m)[:RETURNS],
                timestamp_s=scan.timestamp_s,
                pose=scan.pose,
            )
            for scan in recording(noise_seed=noise_seed).scans[:scans]
        )
    )


def query() -> bytes:
    """Return the body that the map is paths with."""
    return kitti(small(10).scans[6])


def make(data: Path) -> dict[str, object]:
    """Fill a data directory; return what the service answers then."""
    with running(data, admin_key=ADMIN_KEY) as client:
        client.headers.update(ADMIN)
        for name in ("campus", "depot", "yard"):
            client.post("/v1/maps", json={"map": name, "description": f"the {name}"})
        upload(client, "monday", small(10))
        client.patch("/v1/maps/campus/drives/monday", json={"closed": True})
        upload(client, "tuesday", small(4, noise_seed=2))
        upload(client, "wednesday", small(6), slug="depot")
        upload(client, "thursday", small(3), slug="yard")
        jobs = []
        for slug, parameters in (
            ("campus", {"encoding": "paper", "segment_length": 5, "drives": ["monday"]}),
            ("campus", {"encoding": "harmonic", "segment_length": 5, "drives": ["monday"]}),
            ("depot", {"encoding": "paper", "segment_length": 3}),
        ):
            job = client.post(f"/v1/maps/{slug}/builds", json=parameters).json()["job"]
            jobs.append(job)
            assert wait_for(client, job)["state"] == "done"
        client.patch("/v1/maps/depot/drives/wednesday", json={"closed": True})
        client.patch("/v1/maps/depot", json={"retention": {"raw_scans": "drop"}})
        depot = "/v1/maps/depot/drives/wednesday"
        while not client.get(depot).json()["scans_without_returns"]:
            time.sleep(0.1)
        made = [
            client.post("/v1/keys", json={"name": name, "scopes": ["localize"]}).json()
            for name in ("fleet", "lost")
        ]
        client.delete(f"/v1/keys/{made[1]['key']}")
        paths = (*PATHS, *(f"/v1/jobs/{job}" for job in jobs))
        answers = {path: client.get(path).json() for path in paths}
        downloads = {path: digest_of(client.get(path).content) for path in DOWNLOADS}
        found = client.post(
            "/v1/maps/campus/localizations/scan", content=query(), headers=KITTI
        ).json()
    with Store(data) as store:
        waiting = store.jobs.create(
            "yard", {"encoding": "paper", "segment_length": 3, "drives": ["thursday"]}
        )
        state = store.audit.verify().state
    return {
        "answers": answers,
        "downloads": downloads,
        "best": [found["best"]["drive"], found["best"]["scan_index"]],
        "waiting": waiting.id,
        "secret": made[0]["secret"],
        "revoked": made[1]["secret"],
        "audit": [state.seq, state.hash],
    }


def digest_of(content: bytes) -> str:
    """Return a download's SHA-256."""
    return hashlib.sha256(content).hexdigest()


def pack(output: Path) -> None:
    """Make the directory and pack it, with the answers beside it."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "data")
        recorded = make(data)
        stray = data / "orphans" / "maps" / "stray.h5"  # what an earlier start set aside
        stray.parent.mkdir(parents=True)
        stray.write_bytes(b"named by no row")
        Path(folder, "answers.json").write_text(json.dumps(recorded))
        with tarfile.open(output, "w:xz") as tar:
            for name in ("answers.json", "data"):
                tar.add(Path(folder, name), name, filter=_plain)


def _plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    return member


if __name__ == "__main__":
    pack(Path(sys.argv[1]))
