"""How the data directory of a release was made, with what its service answered.

In the worktree of this test: `PYTHONPATH=WORKTREE_OF_THE_RELEASE python tests/upgrade/make.py
RELEASE.tar.xz`: the service that runs is the release's own. A released directory is never made
again: a new release adds its own.
"""

import base64
import hashlib
import json
import os
import sys
import tarfile
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from app.builds.parameters import BuildParameters
from app.revisions.schemas import BasisOut
from core.encodings.basis import Basis
from core.encodings.signature import pack_signatures
from core.projection.imager import Image
from core.scans.scan import Scan
from storage.backup.backup import write_backup
from storage.catalog import JobState
from storage.store import Store
from tests.support.recording import KITTI, Recording, kitti, recording
from tests.support.service import Client, running, upload, wait_for

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
    "/v1/maps/plaza/drives",
    "/v1/maps/plaza/revisions",
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
    """Return the body of the query to map `campus`."""
    return kitti(small(10).scans[6])


def seen() -> list[Scan]:
    """Return scans near those of the map, of one of which only the front was seen."""
    scans = list(small(24, noise_seed=3).scans[5:20:4])
    ahead = scans[1].points_m
    return [*scans, Scan(ahead[np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) < np.radians(90)])]


def asked(client: Client) -> list[dict[str, Any]]:
    """Localize in maps of any and of full views, each live in turn; return what was sent, and got.

    Any views, before they were the default and had verification images, were in another form.
    """
    upload(client, "friday", small(24), slug="plaza")
    client.patch("/v1/maps/plaza/drives/friday", json={"closed": True})
    sent = []
    known = "verification_images" in BuildParameters.model_fields
    for views in ("any", "full") if known else ("full",):
        parameters = {"encoding": "harmonic", "segments": 2, "views": views, "make_live": True}
        job = client.post("/v1/maps/plaza/builds", json=parameters).json()["job"]
        revision = wait_for(client, job)["revision"]
        basis = BasisOut.model_validate(client.get("/v1/maps/plaza/basis").json()).to_core()
        for scan in seen():
            image = basis.image(scan)
            sent += [
                localized(client, revision, "scan", "kitti", kitti(scan)),
                localized(client, revision, "signature", "signature", signed(basis, image)),
            ]
        cells = np.asarray(image.cells, "<f4").tobytes()
        sent.append(localized(client, revision, "image", "image", cells))
    return sent


def signed(basis: Basis, image: Image) -> bytes:
    """Return an image's packed signatures."""
    return pack_signatures(basis.encode(image))


def localized(
    client: Client, revision: str, kind: str, media_type: str, body: bytes
) -> dict[str, Any]:
    """Return a request to the live revision, and its answer."""
    path = f"/v1/maps/plaza/localizations/{kind}?k=3"
    media_type = f"application/vnd.tensormap.{media_type}"
    answer = client.post(path, content=body, headers={"Content-Type": media_type}).json()
    content = base64.b64encode(body).decode()
    return {
        "revision": revision,
        "path": path,
        "type": media_type,
        "body": content,
        "answer": answer,
    }


def make(data: Path) -> dict[str, object]:
    """Fill a data directory; return what the service answers then."""
    with running(data, admin_key=ADMIN_KEY) as client:
        client.headers.update(ADMIN)
        for name in ("campus", "depot", "yard", "plaza"):
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
        sent = asked(client)
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
        # The service stops while the first one runs, and the second one waits for it.
        interrupted, waiting = (
            client.post(f"/v1/maps/{slug}/builds", json=parameters).json()["job"]
            for slug, parameters in (
                ("plaza", {"encoding": "harmonic", "segments": 3}),
                ("yard", {"encoding": "paper", "segment_length": 3}),
            )
        )
    with Store(data) as store:
        assert not store.jobs.get(interrupted).ended
        assert store.jobs.get(waiting).state == JobState.QUEUED
        state = store.audit.verify().state
    return {
        "answers": answers,
        "downloads": downloads,
        "localized": sent,
        "best": [found["best"]["drive"], found["best"]["scan_index"]],
        "interrupted": interrupted,
        "waiting": waiting,
        "secret": made[0]["secret"],
        "revoked": made[1]["secret"],
        "audit": [state.seq, state.hash],
    }


def digest_of(content: bytes) -> str:
    """Return a download's SHA-256."""
    return hashlib.sha256(content).hexdigest()


def pack(output: Path) -> None:
    """Make the directory and pack it, with the answers beside it."""
    os.umask(0o077)  # as the service sets it
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "data")
        recorded = make(data)
        write_backup(data, Path(folder, "backup.tar"))
        stray = data / "orphans" / "maps" / "stray.h5"  # what an earlier start set aside
        stray.parent.mkdir(parents=True)
        stray.write_bytes(b"named by no row")
        Path(folder, "answers.json").write_text(json.dumps(recorded))
        with tarfile.open(output, "w:xz", preset=9) as tar:
            for name in ("answers.json", "data", "backup.tar"):
                tar.add(Path(folder, name), name, filter=_plain)


def _plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    return member


if __name__ == "__main__":
    pack(Path(sys.argv[1]))
