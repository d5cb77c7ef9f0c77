"""Disks that fill up or turn read-only under a running service, as they really do.

In a mount namespace of its own, as an ordinary user may make one, the service writes to a file
system of a few megabytes.
"""

import errno
import os
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.support.process import serving
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, wait_for

NAMESPACE = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "-r", "--mount"]


def can_mount() -> bool:
    try:
        asked = [*NAMESPACE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
        return subprocess.run(asked, capture_output=True, timeout=30).returncode == 0
    except FileNotFoundError:
        return False


pytestmark = pytest.mark.skipif(
    not can_mount(), reason="this user may not mount, not even in a namespace of its own"
)


@contextmanager
def serving_on_a_small_disk(folder: Path, megabytes: int):
    disk = folder / "disk"
    disk.mkdir()
    mounted = f'mount -t tmpfs -o size={megabytes}m tmpfs "$0" && exec "$@"'
    within = [*NAMESPACE, "sh", "-c", mounted, str(disk)]
    with serving(disk / "data", folder / "log", within=within) as server:
        yield server, Path(f"/proc/{server.pid}/root{disk}")


def fill(path: Path) -> None:
    with path.open("wb", buffering=0) as filler:
        for size in (2**16, 2**12, 1):
            try:
                while filler.write(bytes(size)) == size:
                    pass
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise


def localize(server, index):
    body = kitti(recording().scans[index])
    return server.client.post(
        "/v1/maps/campus/localizations/scan", content=body, headers=KITTI
    ).json()["best"]["scan_index"]


def test_a_disk_that_fills_up_is_told_and_loses_nothing(tmp_path):
    with serving_on_a_small_disk(tmp_path, 16) as (server, disk):
        client = server.client
        client.post("/v1/maps", json={"map": "campus"})
        scans = recording().scans
        for index in range(8):
            assert upload_scan(client, "campus", "monday", index, scans[index]).status_code == 201
        job = client.post("/v1/maps/campus/builds", json={"segments": 2}).json()["job"]
        assert wait_for(client, job)["state"] == "done"

        fill(disk / "filler")
        acknowledged = ["campus"]
        for number in range(10_000):  # a few more rows fit into what the catalog has already
            made = client.post("/v1/maps", json={"map": f"map-{number}", "description": "x" * 500})
            if made.status_code != 201:
                break
            acknowledged.append(f"map-{number}")
        assert problem_of(made) == (507, "storage-full")
        for index in (8, 9):
            refused = upload_scan(client, "campus", "monday", index, scans[index])
            assert problem_of(refused) == (507, "storage-full")
        refused = client.post("/v1/maps/campus/builds", json={"segments": 1})
        assert problem_of(refused) == (507, "storage-full")
        not_ready = client.get("/readyz")
        assert not_ready.status_code == 503
        assert "bytes left" in not_ready.json()["missing"][0]
        assert localize(server, 5) == 5
        assert client.get("/v1/maps/campus/drives/monday").json()["scans"] == 8

        (disk / "filler").unlink()
        assert client.get("/readyz").json() == {"ready": True, "missing": []}
        for index in (8, 9):
            assert upload_scan(client, "campus", "monday", index, scans[index]).status_code == 201
        job = client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
        assert wait_for(client, job)["state"] == "done"
        found = client.get("/v1/maps", params={"limit": 1000}).json()["items"]
        assert sorted(item["map"] for item in found) == sorted(acknowledged)
        assert not list(disk.rglob("*.part"))
        for index in range(10):
            got = client.get(f"/v1/maps/campus/drives/monday/scans/{index}").content
            assert got.endswith(scans[index].points_m.astype(np.float32).tobytes())


def test_files_that_turn_read_only_are_told_and_what_is_there_answers(tmp_path):
    with serving_on_a_small_disk(tmp_path, 16) as (server, _):
        client = server.client
        client.post("/v1/maps", json={"map": "campus"})
        scans = recording().scans
        for index in range(6):
            assert upload_scan(client, "campus", "monday", index, scans[index]).status_code == 201
        job = client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
        assert wait_for(client, job)["state"] == "done"
        maps = str(tmp_path / "disk/data/maps")
        remounted = 'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0"'
        user = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
        subprocess.run(
            [
                "nsenter",
                "-t",
                str(server.pid),
                "--mount",
                *user,
                "sh",
                "-c",
                remounted,
                maps,
            ],
            check=True,
            timeout=30,
        )
        for drive in ("monday", "tuesday"):
            refused = upload_scan(client, "campus", drive, 6, scans[6])
            assert problem_of(refused) == (503, "storage-read-only")
        assert client.get("/readyz").json()["missing"] == ["the data directory cannot be written"]
        job = client.post("/v1/maps/campus/builds", json={"segments": 2}).json()["job"]
        failed = wait_for(client, job)
        assert (failed["state"], failed["error"]["type"]) == (
            "failed",
            "/problems/storage-read-only",
        )
        assert localize(server, 3) == 3
        assert client.get("/v1/maps/campus/drives/monday").json()["scans"] == 6
        assert len(client.get("/v1/maps/campus/drives").json()["items"]) == 1
