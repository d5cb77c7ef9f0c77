"""The parts of captures: kept until the job has read them, and not longer."""

import base64
import errno
import hashlib
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest

from app.jobs.runner import JobRunner
from core.progress import NO_PROGRESS
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.errors import StorageFull
from storage.store import Store
from storage.store.verification import verify
from tests.support.access import ADMIN_KEY, READ, WRITE, holder
from tests.support.capture_uploads import (
    KB,
    URL,
    begin,
    complete,
    parts_of,
    put,
    read,
    send,
    sent,
)
from tests.support.service import problem_of, running, wait_for


def test_a_part_is_stored_once_and_only_as_it_was_announced(empty, bag):
    capture = begin(empty, bag)
    first, last = parts_of(bag, 64 * KB)
    digest = base64.b64encode(hashlib.sha256(last).digest()).decode()
    wrong = put(empty, capture, 0, first, **{"Content-Digest": f"sha-256=:{digest}:"})
    assert problem_of(wrong) == (400, "digest-mismatch")
    assert put(empty, capture, 1, last, **{"Content-Digest": f"sha-256=:{digest}:"}).is_success
    assert put(empty, capture, 1, last).status_code == 200
    assert problem_of(put(empty, capture, 1, bytes(len(last)))) == (409, "part-conflict")
    for number, content in ((0, last), (1, first), (2, first), (0, b"")):
        assert problem_of(put(empty, capture, number, content)) == (422, "part-does-not-fit")
    assert problem_of(put(empty, capture, 0, bytes(2**24 + 1))) == (413, "body-too-large")
    assert empty.get(f"{URL}/{capture['capture']}").json()["received"] == [{"first": 1, "last": 1}]
    put(empty, capture, 0, first)
    job = complete(empty, capture).json()["job"]
    assert problem_of(put(empty, capture, 0, first)) == (409, "capture-queued")
    wait_for(empty, job)
    assert empty.delete(f"{URL}/{capture['capture']}").status_code == 204
    assert problem_of(put(empty, capture, 0, first)) == (404, "capture-not-found")


def test_an_upload_is_continued_on_a_disk_that_just_fits_it(empty, bag, monkeypatch):
    data = empty.service.settings.data_dir
    room_bytes = 2 * len(bag) + 4096

    def usage(_):
        used = sum(path.stat().st_size for path in data.rglob("*.bin"))
        return SimpleNamespace(total=0, used=used, free=room_bytes - used)

    digest = hashlib.sha256(bag).hexdigest()
    with monkeypatch.context() as disk:
        disk.setattr(shutil, "disk_usage", usage)
        capture = begin(empty, bag, sha256=digest)
        put(empty, capture, 0, bag[: 64 * KB])
        again = begin(empty, bag, sha256=digest)
        assert again["capture"] == capture["capture"]
        put(empty, capture, 1, bag[64 * KB :])
    wait_for(empty, complete(empty, capture).json()["job"])
    empty.patch("/v1/maps/campus/drives/monday", json={"closed": True})
    assert begin(empty, bag, sha256=digest)["state"] == "done"
    other = empty.post(URL, json={"files": [{"name": "other.mcap", "size_bytes": 9}]})
    assert problem_of(other) == (409, "drive-closed")


def test_an_upload_is_continued_after_a_restart_without_its_id(tmp_path, bag):
    digest = hashlib.sha256(bag).hexdigest()
    first, last = parts_of(bag, 64 * KB)
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        before = begin(client, bag, sha256=digest)
        put(client, before, 0, first)
    with running(tmp_path / "data") as client:
        capture = begin(client, bag, sha256=digest)
        assert capture["capture"] == before["capture"]
        assert capture["missing"] == [{"first": 1, "last": 1}]
        put(client, capture, 1, last)
        job = wait_for(client, complete(client, capture).json()["job"])
        assert job["state"] == "done"
        # Its scans are there: nothing is to be sent.
        assert begin(client, bag, sha256=digest)["state"] == "done"
        client.delete("/v1/maps/campus/drives/monday")
        assert begin(client, bag, sha256=digest)["state"] == "receiving"


def test_parts_that_are_lost_or_damaged_are_named_and_can_be_sent_again(tmp_path, bag):
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        capture = sent(client, bag)
        lost, damaged = sorted((tmp_path / "data").rglob("*.bin"))
        damaged.write_bytes(bytes(len(damaged.read_bytes())))
        job = wait_for(client, complete(client, capture).json()["job"])
        assert job["error"]["type"] == "/problems/parts-missing"
        assert "parts 1 " in job["error"]["detail"]
        lost.unlink()  # as in a restored backup
    with running(tmp_path / "data") as client:
        shown = client.get(f"{URL}/{capture['capture']}").json()
        assert (shown["state"], shown["missing"]) == ("failed", [{"first": 0, "last": 1}])
        send(client, capture, bag)
        assert wait_for(client, complete(client, capture).json()["job"])["state"] == "done"


def test_parts_that_the_disk_does_not_show_at_a_start_are_not_forgotten(tmp_path, bag, monkeypatch):
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        capture = sent(client, bag)
    stat = Path.stat

    def failing(path, **options):
        if path.suffix == ".bin":
            raise OSError(errno.EIO, "Input/output error", str(path))
        return stat(path, **options)

    monkeypatch.setattr(Path, "stat", failing)
    with running(tmp_path / "data") as client:
        monkeypatch.undo()
        assert client.get(f"{URL}/{capture['capture']}").json()["missing"] == []
        assert wait_for(client, complete(client, capture).json()["job"])["state"] == "done"


def test_a_disk_that_fills_while_a_capture_is_put_together_is_named(empty, bag, monkeypatch):
    capture = sent(empty, bag)
    store = empty.service.store
    mkdir = Path.mkdir

    def fill(path, *arguments, **options):
        if path.name == "capture":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        mkdir(path, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", fill)
    opened = store.captures.files(store.captures.of_job(capture["capture"]), NO_PROGRESS)
    with pytest.raises(StorageFull), opened:
        pass
    assert not list(store.layout.maps.rglob(".*.part"))


def test_a_backup_leaves_the_parts_out_and_a_restored_service_misses_them(empty, bag, tmp_path):
    capture = sent(empty, bag)
    write_backup(empty.service.settings.data_dir, tmp_path / "backup.tar")
    restore_backup(tmp_path / "backup.tar", tmp_path / "restored")
    with running(tmp_path / "restored") as restored:
        assert restored.get(f"{URL}/{capture['capture']}").json()["missing"] == capture["missing"]
    assert verify(empty.service.store).findings == ()  # of a service with parts


def test_what_a_capture_may_take_is_limited(tmp_path, bag):
    limits = {"max_upload_bytes": 2**17, "max_capture_bytes_per_key": 2**17 + len(bag) // 2}
    with running(tmp_path / "data", **limits) as client:
        client.post("/v1/maps", json={"map": "campus"})
        job, _ = read(client, bag)
        assert job["state"] == "done"  # 64,800 bytes of returns, and the quota is free again
        begin(client, bag)
        refused = client.post(
            URL, json={"files": [{"name": "b.mcap", "size_bytes": len(bag)}], "topic": "/points"}
        )
        assert problem_of(refused) == (429, "too-many-captures")
    with running(tmp_path / "data", max_upload_bytes=2**17, capture_read_s=1e-9) as client:
        job, _ = read(client, bag, first_scan=9)
        assert job["error"]["type"] == "/problems/capture-too-slow"


@pytest.mark.parametrize(
    ("wanted", "advice"),
    [({"part_bytes": 64 * KB}, "are taken: use larger parts"), ({}, "are taken")],
)
def test_larger_parts_are_advised_where_they_may_be_larger(tmp_path, wanted, advice):
    files = [{"name": "a.mcap", "size_bytes": 10**9}]
    with running(tmp_path / "data", max_body_bytes=65 * KB) as client:
        client.post("/v1/maps", json={"map": "campus"})
        refused = client.post(URL, json={"files": files, **wanted})
        assert problem_of(refused) == (413, "capture-too-large")
        assert refused.json()["detail"].endswith(advice)


def test_captures_expire_and_their_files_with_them(tmp_path, bag):
    with running(tmp_path / "data", capture_hours=1.0) as client:
        client.post("/v1/maps", json={"map": "campus"})
        capture = begin(client, bag)
        put(client, capture, 0, bag[: 64 * KB])
        [listed] = client.get("/v1/maps/campus/captures").json()["items"]
        expires_at = datetime.fromisoformat(listed["expires_at"])
        assert timedelta(minutes=59) < expires_at - datetime.now(UTC) <= timedelta(hours=1)
        captures = client.service.store.captures
        assert captures.clear(expires_at - timedelta(hours=1, seconds=9)) == 0
        assert captures.clear(expires_at) == 1
        assert client.get(URL).json()["items"] == []
        assert not list((tmp_path / "data").rglob("*.bin"))


def test_the_parts_of_a_capture_that_was_read_go_whatever_the_clock_says(tmp_path, bag):
    data = tmp_path / "data"
    with running(data) as client:
        client.post("/v1/maps", json={"map": "campus"})
    (data / "clock.json").write_text('{"at_s": 0.0, "waits_s": 0.0}')
    with running(data) as client:
        idle = begin(client, bag)
        put(client, idle, 0, bag[: 64 * KB])
        capture = begin(client, bag)
        send(client, capture, bag)
        wait_for(client, complete(client, capture).json()["job"])
        assert not client.service.collector.collect()
        assert len(list(data.rglob("*.bin"))) == 1


@pytest.mark.parametrize("end", ["deleted", "expired", "read"])
def test_a_part_that_is_written_while_its_capture_ends_is_rejected_by_name(
    empty, bag, monkeypatch, end
):
    capture = begin(empty, bag)
    first, _ = parts_of(bag, 64 * KB)
    store = empty.service.store

    def while_it_is_written():
        monkeypatch.undo()
        if end == "deleted":
            empty.delete(f"{URL}/{capture['capture']}")
        elif end == "expired":
            store.captures.clear(datetime.now(UTC) + timedelta(hours=1))
        else:  # of a part that is sent twice the other one was faster
            send(empty, capture, bag)
            wait_for(empty, complete(empty, capture).json()["job"])
            store.captures.clear(datetime.now(UTC) - timedelta(hours=1))

    def write_late(path, content):
        while_it_is_written()
        return path.write_bytes(content)

    monkeypatch.setattr(Path, "write_bytes", write_late)
    wanted = (409, "capture-queued") if end == "read" else (404, "capture-not-found")
    assert problem_of(put(empty, capture, 0, first)) == wanted
    assert not list(empty.service.settings.data_dir.rglob("*.bin"))


def test_a_start_removes_what_a_killed_job_left(tmp_path, bag):
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        capture = sent(client, bag)
        deleted = sent(client, bag)
        client.service.runner.stop()
        job_id = complete(client, capture).json()["job"]
    # The process was killed while it read the capture.
    with Store(tmp_path / "data") as store:
        claimed = store.jobs.claim()
        assert claimed is not None
        assert claimed.id == job_id
        [part] = (tmp_path / "data").rglob(f"{capture['capture']}/0.*.bin")
        left = part.parent / ".0123.part" / "capture"
        left.mkdir(parents=True)
        (part.parent / "9.orphan.bin").write_bytes(b"a part whose row was not committed")
        # So it was when the rows of another one were deleted, and not yet its files.
        store.catalog.captures.delete("campus", "monday", deleted["capture"])
    with running(tmp_path / "data") as client:
        assert wait_for(client, job_id)["state"] == "done"
        assert not left.exists()
        assert not list((tmp_path / "data").rglob("9.orphan.bin"))
        assert not list((tmp_path / "data").rglob(deleted["capture"]))


def test_what_a_killed_job_put_together_is_removed_at_once(empty, bag, monkeypatch):
    capture = sent(empty, bag)
    [part] = empty.service.settings.data_dir.rglob("0.*.bin")
    left = part.parent / ".0123.part" / "capture"

    def start_and_kill(make):
        left.mkdir(parents=True)
        worker = make()
        worker.start()
        worker.kill()
        return worker

    monkeypatch.setattr(JobRunner, "_start", staticmethod(start_and_kill))
    job = wait_for(empty, complete(empty, capture).json()["job"])
    assert job["error"]["type"] == "/problems/worker-died"
    assert not left.parent.exists()
    assert part.exists()


def test_a_deleted_capture_ends_its_job(empty, bag):
    empty.service.runner.stop()
    capture = sent(empty, bag)
    job = complete(empty, capture).json()["job"]
    assert empty.delete(f"{URL}/{capture['capture']}").status_code == 204
    assert empty.get(f"/v1/jobs/{job}").json()["state"] == "cancelled"
    assert not list(empty.service.settings.data_dir.rglob("*.bin"))


def test_a_key_limited_to_other_maps_neither_sees_nor_sends_parts(tmp_path):
    with running(tmp_path / "data", admin_key=ADMIN_KEY) as client:
        limited = holder(client, READ, WRITE, maps=["dock"])
        for method, path in (("GET", URL), ("PUT", f"{URL}/{'0' * 32}/parts/0")):
            refused = client.request(method, path, headers=limited)
            assert problem_of(refused) == (404, "map-not-found")
