"""A mapper and an administrator with the client, on a service in this process."""

import asyncio
import dataclasses
import hashlib

import numpy as np
import pytest
from httpx2 import ASGITransport
from tensormap_client import (
    Admin,
    AsyncMapper,
    BuildFailed,
    CaptureFailed,
    InvalidArgument,
    Mapper,
    NothingUsable,
    OtherDrive,
    ScanBody,
)
from tensormap_client._sync.drive_requests import DriveRequests
from tensormap_client.problems import KeyNeeded, MapExists, MapNotFound, RevisionIsLive
from tensormap_client.uploaded import StoredScans

from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.access import ADMIN_KEY
from tests.support.bags import cloud, record_bag
from tests.support.recording import npy
from tests.support.samples import sample_drive
from tests.support.service import running

CLOUDS = [np.random.default_rng(seed).normal(0, 9, (1800, 3)).astype("<f4") for seed in range(3)]
HERE = "http://127.0.0.1"


def mapper_of(client, slug="campus"):
    return Mapper(HERE, None, slug, connections=client._transport)


@pytest.fixture
def small(tmp_path):
    """A service that takes small scans and has the map `campus`."""
    with running(tmp_path / "data", min_returns=1) as client:
        client.post("/v1/maps", json={"map": "campus"})
        yield client


@pytest.fixture
def kitti(tmp_path):
    write_kitti_drive(sample_drive(5), tmp_path / "monday")
    return tmp_path / "monday"


class Stages:
    """A progress that remembers."""

    def __init__(self):
        self.stages, self.done, self.bytes = [], 0, 0

    def start(self, stage, total):
        self.stages.append((stage, total))
        self.done = 0

    def advance(self, units=1):
        self.done += units

    def move_to(self, done):
        self.done = done

    def sent(self, size_bytes):
        self.bytes += size_bytes


@pytest.mark.parametrize("share", [100, 1], ids=["one by one", "in groups"])
def test_two_uploads_of_a_drive_at_once_count_each_scan_once(small, tmp_path, monkeypatch, share):
    monkeypatch.setattr("tensormap_client._sync.upload._LARGEST_SHARE", share)
    # Each saw that nothing is stored, as the other one had just begun.
    seen = iter([StoredScans(), StoredScans(((0, 7),))] * 2)
    monkeypatch.setattr(DriveRequests, "stored", lambda _: next(seen))
    write_kitti_drive(sample_drive(8), tmp_path / "monday")
    with mapper_of(small) as one, mapper_of(small) as other:
        done = [mapper.upload(tmp_path / "monday", "monday") for mapper in (one, other)]
    assert [(each.before, each.stored) for each in done] == [(0, 8), (8, 0)]


def test_an_upload_whose_drive_is_deleted_meanwhile_is_an_error_and_a_second_one_completes_it(
    small, kitti
):
    drive = "/v1/maps/campus/drives/monday"

    class Deleting(Stages):
        def advance(self, units=1):
            super().advance(units)
            if self.done == 2:
                assert small.delete(drive).is_success

    with mapper_of(small) as mapper:
        with pytest.raises(
            OtherDrive, match="has 3 scans, 5 were stored: it was deleted meanwhile"
        ):
            mapper.upload(kitti, "monday", Deleting())
        done = mapper.upload(kitti, "monday")
        assert (done.before, done.stored) == (3, 2)
        assert mapper.drive("monday")["scans_with_pose"] == 5


def test_an_upload_notes_that_the_numbers_of_missing_files_get_lost(small, kitti):
    for file in ("times.txt", "poses.txt", "velodyne/000001.bin", "velodyne/000002.bin"):
        (kitti / file).unlink()
    for number in range(5, 9):
        scan = (kitti / "velodyne" / "000004.bin").read_bytes()[: -16 * number]
        (kitti / "velodyne" / f"{number:06d}.bin").write_bytes(scan)
    with mapper_of(small) as mapper:
        [note] = mapper.upload(kitti, "monday").notes
    assert note.startswith("scan files 1 to 2 are missing, and scans are numbered from 0 without")


def test_a_kitti_folder_is_sent_as_it_is_and_continued(small, kitti):
    progress = Stages()
    headers = {"Content-Type": "application/vnd.tensormap.kitti"}
    for index in (0, 4):
        body = (kitti / f"velodyne/{index:06}.bin").read_bytes()
        path = f"/v1/maps/campus/drives/monday/scans/{index}"
        assert small.put(path, content=body, headers=headers).is_success
    with mapper_of(small) as mapper:
        done = mapper.upload(kitti, "monday", progress)
        assert (done.scans, done.before, done.stored, done.skipped_scans) == (5, 2, 3, 0)
        assert not done.unused_files
        assert (progress.stages, progress.done) == ([("uploading", 5)], 5)
        assert progress.bytes == done.sent_bytes > 0
        assert mapper.drive("monday")["scans_with_pose"] == 5
        poses = small.get("/v1/maps/campus/drives/monday/poses").json()["poses"]
        for pose, known in zip(poses, sample_drive(5).poses, strict=True):
            np.testing.assert_allclose(pose["pose"], known, atol=1e-6)
        (kitti / "velodyne/000000.bin").write_bytes(bytes(np.ones(80, "<f4")))
        with pytest.raises(OtherDrive, match="upload it as another drive"):
            mapper.upload(kitti, "monday")
        (kitti / "velodyne/000004.bin").unlink()
        with pytest.raises(OtherDrive, match="has a scan 4"):
            mapper.upload(kitti, "monday")


def test_a_folder_from_which_a_file_is_gone_is_not_mixed_with_what_was_stored_of_it(
    small, tmp_path
):
    scans = [(np.arange(3.0) + number + 1.0)[None] for number in range(8)]
    files = [tmp_path / "folder" / f"{number:06d}.npy" for number in range(8)]
    files[0].parent.mkdir()
    for file, scan in zip(files[:5], scans, strict=False):
        file.write_bytes(npy(scan.astype(np.float32)))
    with mapper_of(small) as mapper:
        assert mapper.upload(tmp_path / "folder", "monday").stored == 5
        for file, scan in zip(files[5:], scans[5:], strict=True):
            file.write_bytes(npy(scan.astype(np.float32)))
        files[3].unlink()  # the first scan is the same, those after the gap have other indices
        with pytest.raises(OtherDrive, match="scan 4 of drive 'monday'"):
            mapper.upload(tmp_path / "folder", "monday")
        assert mapper.drive("monday")["scans"] == 5


def test_an_upload_with_an_unusable_scan_can_be_repeated_after_its_drive_was_closed(small, kitti):
    lost = kitti / "velodyne/000004.bin"
    scan = lost.read_bytes()
    lost.write_bytes(b"\0" * 16)
    with mapper_of(small) as mapper:
        assert mapper.upload(kitti, "monday").stored == 4
        assert small.patch("/v1/maps/campus/drives/monday", json={"closed": True}).is_success
        again = mapper.upload(kitti, "monday")
        assert (again.before, again.stored, again.skipped_scans) == (4, 0, 1)
        lost.write_bytes(scan)
        with pytest.raises(OtherDrive, match="is closed and has no scan 4: upload it as another"):
            mapper.upload(kitti, "monday")


def test_a_repeated_upload_keeps_poses_that_were_put_and_says_so(small, kitti):
    path = "/v1/maps/campus/drives/monday/poses"
    with mapper_of(small) as mapper:
        assert not mapper.upload(kitti, "monday").notes
        put = {"poses": [{"scan": 0, "pose": [500.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}]}
        assert small.put(path, json=put).is_success
        [note] = mapper.upload(kitti, "monday").notes
    assert note.startswith("times.txt, poses.txt: not sent, as no scan is new and the stored ones")
    assert small.get(path).json()["poses"][0]["pose"][0] == 500.0


@pytest.mark.parametrize("before", [0, 3])
def test_poses_of_an_upload_that_ended_before_them_are_sent_by_its_repetition(
    small, kitti, monkeypatch, before
):
    def lost(*_):
        raise KeyboardInterrupt

    with mapper_of(small) as mapper:
        for index in range(before):
            put = {"content": (kitti / f"velodyne/{index:06}.bin").read_bytes()}
            path = f"/v1/maps/campus/drives/monday/scans/{index}?pose=1,2,3,0,0,0,1"
            headers = {"Content-Type": "application/vnd.tensormap.kitti"}
            assert small.put(path, headers=headers, **put).is_success
        with monkeypatch.context() as patched:
            patched.setattr(DriveRequests, "put_files", lost)
            with pytest.raises(KeyboardInterrupt):
                mapper.upload(kitti, "monday")
        assert mapper.drive("monday")["scans_with_pose"] == before
        assert not mapper.upload(kitti, "monday").notes
        assert mapper.drive("monday")["scans_with_pose"] == 5


def test_files_that_are_named_by_times_are_stored_in_that_order(small, tmp_path):
    times = ["1679000000.5", "1679000000.25", "1679000001.0"]
    for number, time in enumerate(times):
        (tmp_path / f"{time}.npy").write_bytes(npy(np.full((1, 3), number + 1.0, np.float32)))
    with mapper_of(small) as mapper:
        assert mapper.upload(tmp_path, "tuesday").stored == 3
        (tmp_path / "7.npy").write_bytes(b"")
        with pytest.raises(InvalidArgument, match="named by a time, and others"):
            mapper.upload(tmp_path, "tuesday")
    poses = small.get("/v1/maps/campus/drives/tuesday/poses").json()["poses"]
    assert [pose["timestamp_s"] for pose in poses] == sorted(map(float, times))


def test_a_folder_with_a_scan_in_two_formats_is_rejected_before_it_is_sent(small, tmp_path):
    for name in ("000000.npy", "000000.csv", "000001.npy"):
        (tmp_path / name).write_bytes(npy(np.ones((1, 3), np.float32)))
    with mapper_of(small) as mapper, pytest.raises(InvalidArgument, match=r"0.csv and 000000.npy"):
        mapper.upload(tmp_path, "twice")


def test_a_bag_is_sent_in_parts_that_the_service_lacks(small, tmp_path):
    folder = record_bag(tmp_path / "bag", [cloud(points) for points in CLOUDS])
    [bag] = folder.glob("*.mcap")
    content = bag.read_bytes()
    captures = "/v1/maps/campus/drives/monday/captures"
    files = [{"name": bag.name, "size_bytes": len(content)}]
    digest = hashlib.sha256(content).hexdigest()
    begun = small.post(captures, json={"files": files, "sha256": digest}).json()
    size = begun["part_bytes"]
    assert begun["parts"] > 1
    small.put(f"{captures}/{begun['capture']}/parts/0", content=content[:size])
    progress = Stages()
    with mapper_of(small) as mapper:
        done = mapper.upload(bag, "monday", progress)
        assert (done.scans, done.stored, done.before, done.skipped_scans) == (3, 3, 0, 0)
        assert done.sent_bytes == progress.bytes == len(content) - size
        again = mapper.upload(bag, "monday")
        assert (again.stored, again.before, again.sent_bytes) == (0, 3, 0)  # it was read before
        done = mapper.upload(folder, "tuesday")  # as ROS 2 recorded it
        assert (done.scans, done.stored) == (3, 3)
        bag.write_bytes(content[:-100])
        with pytest.raises(CaptureFailed, match=r"capture job \w+ failed"):
            mapper.upload(bag, "wednesday")


def test_what_cannot_be_used_is_reported(small, tmp_path):
    with mapper_of(small) as mapper:
        with pytest.raises(InvalidArgument, match="no scan file"):
            mapper.upload(tmp_path, "monday")
        (tmp_path / "0.pcd").write_bytes(b"no scan")
        with pytest.raises(NothingUsable, match="scan 0"):
            mapper.upload(tmp_path, "monday")
        (tmp_path / "1.npy").write_bytes(npy(np.ones((1, 3), np.float32)))
        done = mapper.upload(tmp_path, "monday")
    assert (done.stored, done.skipped_scans, done.skipped[0].index) == (1, 1, 0)


def test_an_upload_of_which_nothing_can_be_used_lists_its_scans(small, tmp_path):
    for index in range(300):  # groups of several scans, of which none is stored
        (tmp_path / f"{index}.pcd").write_bytes(b"no scan")
    with mapper_of(small) as mapper, pytest.raises(NothingUsable, match="none of the 300") as none:
        mapper.upload(tmp_path, "monday")
    assert [one.index for one in none.value.skipped] == list(range(300))
    assert "no PCD file" in none.value.skipped[-1].reason


def test_a_group_of_scans_that_cannot_be_used_does_not_end_an_upload(small, tmp_path):
    for index in range(300):
        body = b"no scan" if index < 200 else npy(np.full((1, 3), index + 1.0, np.float32))
        (tmp_path / f"{index}.{'pcd' if index < 200 else 'npy'}").write_bytes(body)
    with mapper_of(small) as mapper:
        done = mapper.upload(tmp_path, "monday")
    assert (done.stored, done.skipped_scans) == (100, 200)


class Posed:
    """A source of eight scans; the times fall at the fifth, the second has no unit quaternion."""

    name, beside = "posed", ()

    def __len__(self):
        return 8

    def scan_body(self, index):
        body = npy(np.full((1, 3), index + 1.0, np.float32))
        pose = (float(index), 0.0, 0.0, 0.0, 0.0, 0.0, 2.0 if index == 1 else 1.0)
        time_s = float(index - 3 if index == 4 else index)
        return ScanBody(index, body, "application/vnd.tensormap.npy", time_s, pose)


class PosedByArrays(Posed):
    """The same, with a time and a pose that are rows of arrays, of which NumPy prints the type."""

    def scan_body(self, index):
        scan = super().scan_body(index)
        times_s, poses = np.array([scan.timestamp_s]), np.array([scan.pose], np.float32)
        return dataclasses.replace(
            scan, index=np.int64(index), timestamp_s=times_s[0], pose=poses[0]
        )


@pytest.mark.parametrize("source", [Posed, PosedByArrays])
@pytest.mark.parametrize("share", [100, 1], ids=["one by one", "in groups"])
def test_a_wrong_pose_is_of_one_scan_and_times_may_fall(small, monkeypatch, share, source):
    monkeypatch.setattr("tensormap_client._sync.upload._LARGEST_SHARE", share)
    with mapper_of(small) as mapper:
        done = mapper.upload(source(), "monday")
    assert (done.stored, [one.index for one in done.skipped]) == (7, [1])
    assert "norm 2" in done.skipped[0].reason
    assert done.sent_bytes == 8 * len(Posed().scan_body(0).body)
    shown = small.get("/v1/maps/campus/drives/monday/poses").json()["poses"]
    assert [one["timestamp_s"] for one in shown] == [0.0, 2.0, 3.0, 1.0, 5.0, 6.0, 7.0]


class Moved(Posed):
    """The same scans, with corrected poses."""

    def scan_body(self, index):
        scan = super().scan_body(index)
        return dataclasses.replace(scan, pose=(scan.pose[0] + 5.0, *scan.pose[1:]))


def test_corrected_poses_of_stored_scans_are_noted_and_not_taken(small):
    with mapper_of(small) as mapper:
        assert not mapper.upload(Posed(), "monday").notes
        assert not mapper.upload(Posed(), "monday").notes
        [note] = mapper.upload(Moved(), "monday").notes
    assert note.startswith(
        "scan 0 has another pose or time in posed than in drive 'monday': stored"
    )
    assert note.endswith("keep their poses and times, and PUT .../poses changes them")
    shown = small.get("/v1/maps/campus/drives/monday/poses").json()["poses"]
    assert shown[0]["pose"][0] == 0.0


def test_a_folder_with_times_and_a_calibration_but_no_poses_is_uploaded(small, kitti):
    (kitti / "poses.txt").unlink()
    (kitti / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    with mapper_of(small) as mapper:
        done = mapper.upload(kitti, "monday")
        (kitti / "times.txt").unlink()
        again = mapper.upload(kitti, "tuesday")
    assert done.stored == done.scans
    unused = done.unused_files + again.unused_files
    assert [one.file for one in unused] == ["calib.txt", "calib.txt"]


def test_the_asynchronous_mapper_does_the_same(small, kitti):
    async def uploaded():
        connections = ASGITransport(small.app, client=("127.0.0.1", 5000))
        async with AsyncMapper(HERE, None, "campus", connections=connections) as mapper:
            await mapper.upload(kitti, "monday")
            return await mapper.drive("monday")

    shown = asyncio.run(uploaded())
    assert (shown["scans"], shown["scans_with_pose"]) == (5, 5)


def test_a_map_is_administered(own, built):
    with Admin(HERE, connections=own._transport) as admin:
        assert [one["map"] for one in admin.maps()] == ["campus"]
        assert admin.create_map("dock", "by the sea")["description"] == "by the sea"
        with pytest.raises(MapExists):
            admin.create_map("dock")
        admin.delete_map("dock")
        with pytest.raises(MapNotFound):
            admin.map("dock")
        [deleted] = admin.recycle_bin()
        admin.restore(deleted["entry"])
        assert admin.map("dock")["description"] == "by the sea"
        admin.delete_map("dock")
        [deleted] = admin.recycle_bin()
        admin.purge(deleted["entry"])
        assert not list(admin.recycle_bin())

        assert {one["revision"] for one in admin.revisions("campus")} == {built.live, built.other}
        assert admin.revision("campus", built.live)["live"]
        assert admin.make_live("campus", built.other)["live_revision"] == built.other
        assert admin.comparison("campus", built.live)["this"]["revision"] == built.live
        with pytest.raises(RevisionIsLive):
            admin.delete_revision("campus", built.other)
        admin.delete_revision("campus", built.live)

        progress = Stages()
        job = admin.build("campus", {"segments": 4, "encoding": "paper"}, progress)
        assert admin.revision("campus", job["revision"])["segments"] == 4
        assert progress.stages
        with pytest.raises(BuildFailed, match="cancelled"):
            admin.follow(admin.cancel(admin.start_build("campus")["job"]))
        assert len(list(admin.jobs("campus"))) == 4
        assert [one["drive"] for one in admin.drives("campus")] == ["monday"]
        admin.delete_drive("campus", "monday")
        assert not list(admin.drives("campus"))


def test_keys_and_the_audit_trail(guarded):
    with Admin(HERE, connections=guarded._transport) as nobody, pytest.raises(KeyNeeded):
        list(nobody.maps())
    with Admin(HERE, ADMIN_KEY, connections=guarded._transport) as admin:
        made = admin.make_key("a fleet", ["localize"], maps=["campus"])
        listed = {one["key"]: one for one in admin.keys()}  # noqa: SIM118 - no dict
        assert listed[made["key"]]["maps"] == ["campus"]
        assert admin.revoke_key(made["key"])["revoked_at"] is not None
        acts = list(admin.audit())
    about_keys = [(act["subject"], act["outcome"]) for act in acts if "keys" in act["subject"]]
    assert about_keys == [("/v1/keys", "done"), (f"/v1/keys/{made['key']}", "done")]


def test_lists_have_no_end_at_a_page(empty):
    with Admin(HERE, connections=empty._transport) as admin:
        for number in range(4):
            admin.create_map(f"map-{number}")
        listed = [one["map"] for one in admin._pages("/v1/maps", {"limit": 2})]
        assert listed == ["campus", *(f"map-{number}" for number in range(4))]
        assert [one["map"] for one in admin.maps()] == listed
