"""Captures and bags that are uploaded in parts over HTTP, and read into a drive by a job."""

import base64
import errno
import hashlib
import io
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app.captures.reading import read_capture
from app.drives import scan_group
from app.jobs.runner import JobRunner
from core.progress import NO_PROGRESS
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.errors import DriveNotFound
from storage.store import Store
from storage.store.verification import verify
from tests.support.access import ADMIN_KEY, READ, WRITE, holder
from tests.support.bags import BEGIN_NS, cloud, record_bag
from tests.support.captures import hdl32, pcap, udp
from tests.support.service import problem_of, running, wait_for

URL = "/v1/maps/campus/drives/monday/captures"
KB = 2**10
SCANS = [np.random.default_rng(seed).normal(0, 9, (1800, 3)).astype("<f4") for seed in range(3)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> bytes:
    """An MCAP of three clouds on one topic; in parts of 64 KiB it has two."""
    folder = record_bag(tmp_path_factory.mktemp("bag") / "bag", map(cloud, SCANS))
    [file] = folder.glob("*.mcap")
    return file.read_bytes()


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


def test_parts_in_any_order_become_the_scans_of_the_drive_with_their_times(empty, bag):
    capture = begin(empty, bag)
    assert (capture["state"], capture["parts"]) == ("receiving", 2)
    assert capture["missing"] == [{"first": 0, "last": 1}]
    first, last = parts_of(bag, 64 * KB)
    assert put(empty, capture, 1, last).json()["missing"] == [{"first": 0, "last": 0}]
    refused = complete(empty, capture)
    assert problem_of(refused) == (409, "parts-missing")
    assert "missing are 0" in refused.json()["detail"]
    assert put(empty, capture, 0, first).json()["missing"] == []
    answer = complete(empty, capture)
    assert answer.headers["Location"] == f"/v1/jobs/{answer.json()['job']}"
    job = wait_for(empty, answer.json()["job"])
    assert (job["kind"], job["state"], job["revision"]) == ("capture", "done", None)
    assert (job["stage"], job["done"], job["total"]) == ("storing", 3, 3)
    done = empty.get(f"{URL}/{capture['capture']}").json()
    assert done["scans"] == {"scans": 3, "stored": 3, "present": 0, "skipped": 0}
    for index, points_m in enumerate(SCANS):
        np.testing.assert_array_equal(stored_m(empty, index), points_m)
    poses = empty.get("/v1/maps/campus/drives/monday/poses").json()["poses"]
    assert poses[0]["timestamp_s"] == BEGIN_NS * 1e-9
    # The parts are gone, and the answer stays the same.
    empty.service.collector.collect()
    assert not list(empty.service.settings.data_dir.rglob("*.bin"))
    again = complete(empty, capture).json()
    assert (again["state"], again["job"], again["missing"]) == ("done", job["job"], [])


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


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ({"files": [{"name": "a.zip", "size_bytes": 9}]}, (422, "unknown-drive-layout")),
        ({"files": [{"name": "metadata.yaml", "size_bytes": 9}]}, (422, "unknown-drive-layout")),
        ({"files": [{"name": "a.bag", "size_bytes": 9}] * 2}, (422, "unknown-drive-layout")),
        (
            {"files": [{"name": "a.pcap", "size_bytes": 9}], "topic": "/x"},
            (422, "unknown-drive-layout"),
        ),
        (
            {"files": [{"name": "a.bag", "size_bytes": 9}], "topic": "/x\0y"},
            (422, "invalid-request"),
        ),
        ({"files": [{"name": "../a.bag", "size_bytes": 9}]}, (422, "invalid-request")),
        ({"files": [{"name": "a.bag", "size_bytes": 0}]}, (422, "invalid-request")),
        ({"files": [{"name": "a.bag", "size_bytes": 2**40}]}, (413, "capture-too-large")),
    ],
)
def test_what_cannot_be_read_is_rejected_before_a_byte_is_sent(client, body, problem):
    assert problem_of(client.post(URL, json=body)) == problem
    assert client.get(URL).json()["items"] == []


class AtScan:
    """A progress that calls something before a scan is stored."""

    def __init__(self, number, call):
        self.number, self.call = number, call
        self.stage = ""

    def start(self, stage, _total):
        self.stage, self.done = stage, 0

    def advance(self, units=1):
        self.done += units
        if (self.stage, self.done) == ("storing", self.number):
            self.call()


def test_a_drive_that_is_deleted_while_its_capture_is_read_is_not_split(empty, bag, monkeypatch):
    monkeypatch.setattr(scan_group, "_GROUP_SCANS", 1)
    empty.service.runner.stop()
    store = empty.service.store
    digest = hashlib.sha256(bag).hexdigest()
    capture = sent(empty, bag, sha256=digest)
    complete(empty, capture)
    job = store.jobs.claim()
    delete = AtScan(2, lambda: empty.delete("/v1/maps/campus/drives/monday"))
    with pytest.raises(DriveNotFound, match="deleted while its scans were stored") as failed:
        read_capture(store, empty.service.settings, job, delete)
    store.jobs.fail(job.id, "DriveNotFound", str(failed.value))
    assert problem_of(empty.get("/v1/maps/campus/drives/monday")) == (404, "drive-not-found")
    [entry] = empty.get("/v1/recycle-bin").json()["items"]
    assert empty.post(f"/v1/recycle-bin/{entry['entry']}/restore").status_code == 200
    # The parts are kept: the restored drive gets the rest of its scans.
    assert begin(empty, bag, sha256=digest)["missing"] == []
    complete(empty, capture)
    done = read_capture(store, empty.service.settings, store.jobs.claim(), NO_PROGRESS)
    assert (done.present, done.stored) == (2, 1)
    assert done.as_json()["drive_id"] == store.drives.get("campus", "monday").id


@pytest.mark.parametrize(
    ("failing", "message"),
    [
        (lambda: np.empty(2**50, np.uint8), "Unable to allocate .*; 2 of its 3 scans are stored"),
        (lambda: bytearray(2**60), "^2 of its 3 scans are stored in drive 'monday'$"),
    ],
)
def test_a_lack_of_memory_after_some_scans_says_how_many_are_stored(
    empty, bag, monkeypatch, failing, message
):
    monkeypatch.setattr(scan_group, "_GROUP_SCANS", 1)
    empty.service.runner.stop()
    capture = sent(empty, bag)
    complete(empty, capture)
    job = empty.service.store.jobs.claim()
    with pytest.raises(MemoryError, match=message):
        read_capture(empty.service.store, empty.service.settings, job, AtScan(2, failing))


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


def test_a_backup_leaves_the_parts_out_and_a_restored_service_misses_them(empty, bag, tmp_path):
    capture = sent(empty, bag)
    write_backup(empty.service.settings.data_dir, tmp_path / "backup.tar")
    restore_backup(tmp_path / "backup.tar", tmp_path / "restored")
    with running(tmp_path / "restored") as restored:
        assert restored.get(f"{URL}/{capture['capture']}").json()["missing"] == capture["missing"]
    assert verify(empty.service.store).findings == ()  # of a service with parts


def test_an_unknown_topic_is_an_error_that_names_those_there_are(empty, tmp_path):
    folder = record_bag(tmp_path / "two", map(cloud, SCANS), topics=("/front", "/rear"))
    content = next(folder.glob("*.mcap")).read_bytes()
    job, capture = read(empty, content)
    assert (job["state"], capture["state"]) == ("failed", "failed")
    assert capture["error"]["type"] == "/problems/malformed-drive"
    assert "/front (3), /rear (3)" in capture["error"]["detail"]
    assert str(tmp_path) not in capture["error"]["detail"]
    assert problem_of(empty.get("/v1/maps/campus/drives/monday")) == (404, "drive-not-found")
    # The parts are kept: another topic needs no other upload.
    answer = complete(empty, capture, topic="/rear").json()
    assert wait_for(empty, answer["job"])["state"] == "done"
    assert empty.get("/v1/maps/campus/drives/monday").json()["scans"] == 3


def test_a_folder_of_ros_2_and_a_bag_of_ros_1_are_read(empty, tmp_path):
    folder = record_bag(tmp_path / "two", map(cloud, SCANS))
    files = sorted(folder.iterdir(), reverse=True)
    content = b"".join(file.read_bytes() for file in files)
    begun = empty.post(
        URL, json={"files": [{"name": f.name, "size_bytes": f.stat().st_size} for f in files]}
    )
    send(empty, begun.json(), content)
    job = wait_for(empty, complete(empty, begun.json()).json()["job"])
    assert job["state"] == "done", job
    bag = record_bag(tmp_path / "one", (cloud(points, 1) for points in SCANS), ros=1)
    job, capture = read(empty, bag.read_bytes(), "one.bag", first_scan=1)
    assert job["error"]["type"] == "/problems/scan-conflict"
    job, capture = read(empty, bag.read_bytes(), "one.bag", first_scan=3)
    assert capture["scans"]["stored"] == 3
    assert empty.get("/v1/maps/campus/drives/monday").json()["present"] == [{"first": 0, "last": 5}]


def test_a_pcap_is_read_and_a_truncated_one_stores_nothing(empty):
    content = pcap([frame for payload in hdl32(turns=3.2) for frame in udp(payload, 2368)])
    job, capture = read(empty, content[:-100], "monday.pcap")
    assert job["error"]["type"] == "/problems/truncated-scan"
    assert "the capture ends" in job["error"]["detail"]
    assert problem_of(empty.get("/v1/maps/campus/drives/monday")) == (404, "drive-not-found")
    _, capture = read(empty, content, "monday.pcap")
    assert capture["scans"] == {"scans": 3, "stored": 3, "present": 0, "skipped": 0}


def test_scans_that_cannot_be_used_are_skipped_and_named(empty, tmp_path):
    clouds = [cloud(SCANS[0]), cloud(SCANS[1][:40]), cloud(SCANS[2])]
    content = next(record_bag(tmp_path / "bag", clouds).glob("*.mcap")).read_bytes()
    job, capture = read(empty, content)
    assert capture["scans"] == {"scans": 3, "stored": 2, "present": 0, "skipped": 1}
    [note] = job["notes"]
    assert note.startswith("scan 1 was skipped: ")
    assert empty.get("/v1/maps/campus/drives/monday").json()["gaps"] == [{"first": 1, "last": 1}]


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


@pytest.mark.parametrize(
    "name", ["2024-01-01T10:00:00.bag", "o'neil.bag", "-a #1.mcap", "x" * 250 + ".bag", r"ä\é.db3"]
)
def test_a_file_may_have_any_name_that_a_disk_has(client, name):
    answer = client.post(URL, json={"files": [{"name": name, "size_bytes": 9}]})
    assert answer.status_code == 201
    assert answer.json()["files"][0]["name"] == name
    client.delete(f"{URL}/{answer.json()['capture']}")


@pytest.mark.parametrize(
    "name", [".bag", "a/b.bag", r"a\u0000.bag", r"a\n.bag", "é" * 126 + ".bag"]
)
def test_a_name_that_is_no_files_is_rejected_and_what_is_wanted_is_said(client, name):
    body = f'{{"files": [{{"name": "{name}", "size_bytes": 9}}]}}'
    refused = client.post(URL, content=body, headers={"Content-Type": "application/json"})
    assert problem_of(refused) == (422, "invalid-request")
    assert "wanted " in refused.json()["errors"][0]["what"]


def test_a_deleted_capture_ends_its_job(empty, bag):
    empty.service.runner.stop()
    capture = sent(empty, bag)
    job = complete(empty, capture).json()["job"]
    assert empty.delete(f"{URL}/{capture['capture']}").status_code == 204
    assert empty.get(f"/v1/jobs/{job}").json()["state"] == "cancelled"
    assert not list(empty.service.settings.data_dir.rglob("*.bin"))


def test_a_key_limited_to_other_maps_neither_sees_nor_sends_parts(tmp_path, bag):
    with running(tmp_path / "data", admin_key=ADMIN_KEY) as client:
        limited = holder(client, READ, WRITE, maps=["dock"])
        for method, path in (("GET", URL), ("PUT", f"{URL}/{'0' * 32}/parts/0")):
            refused = client.request(method, path, headers=limited)
            assert problem_of(refused) == (404, "map-not-found")
