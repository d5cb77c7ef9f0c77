"""Disks that fill up or turn read-only under a running service, as they really do.

In a mount namespace of its own, as an ordinary user may make one, the service writes to a file
system of a few megabytes.
"""

import errno
import itertools
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from core.scans.scan import Scan
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.store import Store
from tests.support.commands import PROGRAM, ROOT
from tests.support.process import serving, until
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, wait_for

NAMESPACE = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "-r", "--mount"]


def can_mount() -> bool:
    try:
        requested = [*NAMESPACE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
        return subprocess.run(requested, capture_output=True, timeout=30).returncode == 0
    except FileNotFoundError:
        return False


pytestmark = pytest.mark.skipif(
    not can_mount(), reason="this user may not mount, not even in a namespace of its own"
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A service, and what it sees as its disk of 16 MB."""
    folder = tmp_path_factory.mktemp("small")
    disk = folder / "disk"
    disk.mkdir()
    mounted = 'mount -t tmpfs -o size=16m tmpfs "$0" && exec "$@"'
    within = [*NAMESPACE, "sh", "-c", mounted, str(disk)]
    with serving(disk / "data", folder / "log", within=within) as server:
        yield server, disk


def seen_by(server, path):
    return Path(f"/proc/{server.pid}/root{path}")


def run_within(server, script, *words):
    """Run a script where the service's mounts are."""
    user = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
    entered = ["nsenter", "-t", str(server.pid), "--mount", *user, "sh", "-c", script, *words]
    subprocess.run(entered, check=True, timeout=30)


def built_map(client, slug, scans):
    """Make a map of the drive `monday` that answers."""
    client.post("/v1/maps", json={"map": slug})
    for index in range(scans):
        scan = recording().scans[index]
        assert upload_scan(client, slug, "monday", index, scan).status_code == 201
    job = client.post(f"/v1/maps/{slug}/builds", json={"segments": 2}).json()["job"]
    assert wait_for(client, job)["state"] == "done"


def fill(path: Path) -> None:
    with path.open("wb", buffering=0) as filler:
        for size in (2**16, 2**12, 1):
            try:
                while filler.write(bytes(size)) == size:
                    pass
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise


def localize(client, slug, index):
    return client.post(
        f"/v1/maps/{slug}/localizations/scan",
        content=kitti(recording().scans[index]),
        headers=KITTI,
    ).json()["best"]["scan_index"]


def test_a_disk_that_fills_up_is_reported_and_loses_nothing(small):
    server, disk = small
    client, seen = server.client, seen_by(server, disk)
    built_map(client, "filled", 8)
    scans = recording().scans
    acknowledged = {item["map"] for item in client.get("/v1/maps").json()["items"]}

    fill(seen / "filler")
    for number in range(10_000):  # a few more rows fit into what the catalog has already
        made = client.post("/v1/maps", json={"map": f"map-{number}", "description": "x" * 500})
        if made.status_code != 201:
            break
        acknowledged.add(f"map-{number}")
    assert problem_of(made) == (507, "storage-full")
    for index in (8, 9):
        refused = upload_scan(client, "filled", "monday", index, scans[index])
        assert problem_of(refused) == (507, "storage-full")
    refused = client.post("/v1/maps/filled/builds", json={"segments": 1})
    assert problem_of(refused) == (507, "storage-full")
    not_ready = client.get("/readyz")
    assert not_ready.status_code == 503
    assert "bytes left" in not_ready.json()["missing"][0]
    assert localize(client, "filled", 5) == 5
    assert client.get("/v1/maps/filled/drives/monday").json()["scans"] == 8

    (seen / "filler").unlink()
    assert client.get("/readyz").json() == {"ready": True, "missing": []}
    for index in (8, 9):
        assert upload_scan(client, "filled", "monday", index, scans[index]).status_code == 201
    job = client.post("/v1/maps/filled/builds", json={"segments": 1}).json()["job"]
    assert wait_for(client, job)["state"] == "done"
    found = client.get("/v1/maps", params={"limit": 1000}).json()["items"]
    assert sorted(item["map"] for item in found) == sorted(acknowledged)
    # The service writes its clock now and then.
    until(lambda: not list(seen.rglob("*.part")), "an incomplete file is left")
    for index in range(10):
        got = client.get(f"/v1/maps/filled/drives/monday/scans/{index}").content
        assert got.endswith(scans[index].points_m.astype(np.float32).tobytes())


def test_a_disk_that_scans_filled_has_space_to_delete_them(small):
    server, disk = small
    client, seen = server.client, seen_by(server, disk)
    client.post("/v1/maps", json={"map": "heaped"})
    rng = np.random.default_rng(0)
    indices = itertools.count()
    for returns in (40_000, 4_000, 400):
        scans = (Scan(rng.random((returns, 3), np.float32) + 1.0) for _ in range(1000))
        puts = (upload_scan(client, "heaped", "monday", next(indices), scan) for scan in scans)
        put = next(put for put in puts if put.status_code != 201)
        assert problem_of(put) == (507, "storage-full")
    assert "kept free for the catalog" in put.json()["detail"]
    assert client.get("/readyz").status_code == 503
    used = shutil.disk_usage(seen).used

    drive = "/v1/maps/heaped/drives/monday"
    assert client.delete(drive, params={"purge": True}).status_code == 204
    assert shutil.disk_usage(seen).used < used / 2
    assert client.get("/readyz").json() == {"ready": True, "missing": []}
    assert upload_scan(client, "heaped", "monday", 0, recording().scans[0]).status_code == 201


@pytest.fixture
def read_only(small):
    """A map of a service that cannot write any longer, while a test lasts."""
    server, disk = small
    built_map(server.client, "frozen", 6)
    maps = str(disk / "data/maps")
    run_within(server, 'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0"', maps)
    yield server.client
    run_within(server, 'umount "$0"', maps)
    assert server.client.get("/readyz").json() == {"ready": True, "missing": []}


def test_files_that_turn_read_only_are_reported_and_reads_are_answered(read_only):
    client = read_only
    for drive in ("monday", "tuesday"):
        refused = upload_scan(client, "frozen", drive, 6, recording().scans[6])
        assert problem_of(refused) == (503, "storage-read-only")
    assert client.get("/readyz").json()["missing"] == ["the data directory cannot be written"]
    job = client.post("/v1/maps/frozen/builds", json={"segments": 1}).json()["job"]
    failed = wait_for(client, job)
    assert (failed["state"], failed["error"]["type"]) == ("failed", "/problems/storage-read-only")
    assert localize(client, "frozen", 3) == 3
    assert client.get("/v1/maps/frozen/drives/monday").json()["scans"] == 6
    assert len(client.get("/v1/maps/frozen/drives").json()["items"]) == 1


def test_a_start_on_a_full_disk_says_that_no_space_is_left(tmp_path):
    data, disk = tmp_path / "data", tmp_path / "disk"
    disk.mkdir()
    Store.serving(data).close()
    filled = 'mount -t tmpfs -o size=2m tmpfs "$0" && cp -a "$1" "$0" && shift &&'
    filled += ' { cat /dev/zero >"$0/filler" 2>/dev/null; exec "$@"; }'
    within = [*NAMESPACE, "sh", "-c", filled, str(disk), str(data)]
    serve = [*PROGRAM, "serve", "--data", str(disk / "data"), "--port", "0"]
    ended = subprocess.run([*within, *serve], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1
    assert "tensormap: no space is left for the catalog's database: free some" in ended.stderr


def tensormap_read_only(folder, *words):
    """Run a command that sees a folder as a read-only mount; return its status and output."""
    mounted = 'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0" && exec "$@"'
    within = [*NAMESPACE, "sh", "-c", mounted, str(folder)]
    run = [*within, *PROGRAM, *map(str, words)]
    ended = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=300)
    return ended.returncode, ended.stdout + ended.stderr


@pytest.mark.parametrize("snapshot_of", ["a running service", "a stopped service"])
def test_a_read_only_snapshot_is_verified_and_backed_up(tmp_path, snapshot_of):
    data, snapshot = tmp_path / "data", tmp_path / "snapshot"
    with Store.serving(data) as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, recording().scans[0])
        if snapshot_of == "a running service":
            shutil.copytree(data, snapshot)
    if snapshot_of == "a stopped service":
        shutil.copytree(data, snapshot)
    status, shown = tensormap_read_only(snapshot, "verify", "--data", snapshot)
    assert status == 0
    assert f"{snapshot}: 1 file checked, 0 damaged or missing\n" in shown
    path = tmp_path / "backup.tar"
    status, shown = tensormap_read_only(snapshot, "backup", "--data", snapshot, "-o", path)
    assert (status, shown.partition(",")[0]) == (0, f"{path}: 1 file")
    assert restore_backup(path, tmp_path / "restored").files == 1


def test_a_backup_is_restored_into_a_mount_point(tmp_path):
    with Store.serving(tmp_path / "data") as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, recording().scans[0])
    write_backup(tmp_path / "data", tmp_path / "backup.tar")
    (tmp_path / "disk").mkdir()
    script = (
        "mount -t tmpfs tmpfs disk && "
        '"$@" restore backup.tar --data disk && "$@" verify --data disk'
    )
    run = [*NAMESPACE, "sh", "-c", script, "sh", *PROGRAM]
    ended = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert "disk: 1 file checked, 0 damaged or missing\n" in ended.stdout


def test_what_must_be_written_is_refused_on_a_read_only_file_system(tmp_path):
    data = tmp_path / "data"
    with Store.serving(data) as store:
        store.maps.create("campus")
    for command in (["serve", "--port", "0"], ["verify", "--repair"]):
        status, shown = tensormap_read_only(data, *command, "--data", data)
        assert status == 1
        assert "cannot be written" in shown or "Read-only file system" in shown
        assert "Traceback" not in shown
