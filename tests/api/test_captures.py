"""Captures and bags that are uploaded in parts over HTTP, and read into a drive by a job."""

import hashlib
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin
from ruamel.yaml import YAML

from app.captures.reading import read_capture
from app.drives import scan_group
from core.errors import EmptyDrive
from core.progress import NO_PROGRESS
from storage.errors import DriveNotFound
from tests.support.bags import BEGIN_NS, CLOUD, cloud, record_bag
from tests.support.capture_uploads import (
    KB,
    SCANS,
    URL,
    begin,
    complete,
    parts_of,
    put,
    read,
    send,
    sent,
    stored_m,
)
from tests.support.captures import hdl32, pcap, udp
from tests.support.service import problem_of, wait_for


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


def temporary_files():
    """Return where the files are that this process has open, and that have no name."""
    opened = map(os.path.realpath, Path("/proc/self/fd").iterdir())
    return {name for name in opened if name.endswith(" (deleted)")}


def test_what_sqlite_sorts_of_a_bag_is_written_beside_it(empty, tmp_path):
    """Where the space is checked: in /var/tmp 12 kB took 3 GB, in a container's memory."""
    path = tmp_path / "bag.db3"
    with closing(sqlite3.connect(path)) as bag:
        bag.executescript(
            "CREATE TABLE topics(id, name, type, serialization_format);"
            f"INSERT INTO topics VALUES(1, '/points', '{CLOUD}', 'cdr');"
            "CREATE TABLE messages(id, topic_id, timestamp, data AS (zeroblob(2000000)));"
            "INSERT INTO messages VALUES" + ",".join(f"({n}, 1, {-n})" for n in range(20))
        )
    empty.service.runner.stop()
    complete(empty, sent(empty, path.read_bytes(), path.name))
    job = empty.service.store.jobs.claim()
    before, written = temporary_files(), set()
    look = AtScan(2, lambda: written.update(temporary_files() - before))
    with pytest.raises(EmptyDrive):
        read_capture(empty.service.store, empty.service.settings, job, look)
    assert written
    maps = empty.service.settings.data_dir / "maps"
    assert all(name.startswith(str(maps)) for name in written), written


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


def test_a_capture_that_is_begun_again_with_another_topic_has_that_one(empty, bag):
    digest = hashlib.sha256(bag).hexdigest()
    capture = begin(empty, bag, sha256=digest, topic="/front")
    again = begin(empty, bag, sha256=digest, topic="/rear")
    assert (again["capture"], again["topic"]) == (capture["capture"], "/rear")


def test_a_capture_cannot_be_completed_while_its_job_is_being_cancelled(empty, bag):
    empty.service.runner.stop()
    capture = sent(empty, bag)
    job = complete(empty, capture).json()["job"]
    empty.service.store.jobs.claim()
    assert empty.delete(f"/v1/jobs/{job}").is_success
    refused = complete(empty, capture, topic="/rear")
    assert problem_of(refused) == (409, "capture-queued")
    assert empty.get(f"{URL}/{capture['capture']}").json()["topic"] is None


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


def test_a_name_leads_to_no_other_file_of_the_machine(empty, tmp_path):
    """Not as a URL either, by which SQLite opens a bag: the bag of somebody else was stored."""
    folder = record_bag(tmp_path / "other", map(cloud, SCANS), plugin=StoragePlugin.SQLITE3)
    [bag] = folder.glob("*.db3")
    other = bag.rename(empty.service.settings.data_dir / "other.db3")
    up_to_it = "%2e%2e%2f" * len(("maps", "MAP", "captures", "CAPTURE", "SCRATCH", "capture"))
    job, capture = read(empty, b"no bag", f"{up_to_it}other.db3")
    assert (job["state"], capture["scans"]) == ("failed", None)
    assert job["error"]["detail"].endswith("file is not a database")
    job, capture = read(empty, other.read_bytes(), "a %41#1.db3")
    assert capture["scans"] == {"scans": 3, "stored": 3, "present": 0, "skipped": 0}


def test_an_error_of_what_a_library_unpacked_names_no_folder_of_the_service(empty, tmp_path):
    folder = record_bag(tmp_path / "two", map(cloud, SCANS), plugin=StoragePlugin.SQLITE3)
    yaml = YAML(typ="safe")
    metadata = yaml.load(folder / "metadata.yaml")
    packed = {"compression_mode": "FILE", "compression_format": "zstd"}
    metadata["rosbag2_bagfile_information"] |= packed
    yaml.dump(metadata, folder / "metadata.yaml")
    [bag] = folder.glob("*.db3")
    bag.write_bytes(zstandard.compress(b"no bag"))
    files = sorted(folder.iterdir())
    names = [{"name": file.name, "size_bytes": file.stat().st_size} for file in files]
    begun = empty.post(URL, json={"files": names}).json()
    send(empty, begun, b"".join(file.read_bytes() for file in files))
    error = wait_for(empty, complete(empty, begun).json()["job"])["error"]
    assert error["detail"].endswith("file is not a database")
    assert str(empty.service.settings.data_dir) not in error["detail"]


def test_a_pcap_is_read_and_a_truncated_one_stores_nothing(empty):
    content = pcap([frame for payload in hdl32(turns=3.2) for frame in udp(payload, 2368)])
    job, capture = read(empty, content[:-100], "monday.pcap")
    assert job["error"]["type"] == "/problems/truncated-scan"
    assert "the capture ends" in job["error"]["detail"]
    assert problem_of(empty.get("/v1/maps/campus/drives/monday")) == (404, "drive-not-found")
    _, capture = read(empty, content, "monday.pcap")
    assert capture["scans"] == {"scans": 3, "stored": 3, "present": 0, "skipped": 0}


def test_a_topic_of_a_pcap_is_refused_at_its_end_as_at_its_begin(empty):
    capture = sent(empty, pcap([]), "monday.pcap")
    refused = complete(empty, capture, topic="/points")
    assert problem_of(refused) == (422, "unknown-drive-layout")
    assert refused.json()["detail"] == "a .pcap has no topics, '/points' was given"
    assert empty.get(f"{URL}/{capture['capture']}").json()["state"] == "receiving"


@pytest.mark.parametrize(("first_scan", "skipped"), [(0, 1), (7, 8)])
def test_scans_that_cannot_be_used_are_skipped_and_named_as_in_the_drive(
    empty, tmp_path, first_scan, skipped
):
    clouds = [cloud(SCANS[0]), cloud(SCANS[1][:40]), cloud(SCANS[2])]
    content = next(record_bag(tmp_path / "bag", clouds).glob("*.mcap")).read_bytes()
    job, capture = read(empty, content, first_scan=first_scan)
    assert capture["scans"] == {"scans": 3, "stored": 2, "present": 0, "skipped": 1}
    [note] = job["notes"]
    assert note.startswith(f"scan {skipped} was skipped: ")
    gaps = empty.get("/v1/maps/campus/drives/monday").json()["gaps"]
    assert gaps[-1] == {"first": skipped, "last": skipped}


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
