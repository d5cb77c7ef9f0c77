"""An administrator with the client, on a service in this process."""

import asyncio
import itertools
import re

import numpy as np
import pytest
import tensormap_client
from httpx2 import ASGITransport
from tensormap_client import Admin, AsyncAdmin, InvalidArgument, Mapper, Mounting
from tensormap_client.problems import (
    BasisInUse,
    DriveClosed,
    DriveNotFound,
    InvalidMap,
    InvalidPose,
    InvalidRequest,
    MapNotAnchored,
    MapNotFound,
    PosesDoNotFit,
    ScopeMissing,
)

from tests.support.access import ADMIN_KEY
from tests.support.commands import ROOT
from tests.support.recording import npy, recording, upload_scan
from tests.support.service import copy_of, running

HERE = "http://127.0.0.1"
AHEAD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def admin_of(client, key=None):
    return Admin(HERE, key, connections=client._transport)


@pytest.fixture
def driven(empty):
    """A service that has the map `campus` with three scans of drive `monday`."""
    for index, scan in enumerate(recording().scans[:3]):
        upload_scan(empty, "campus", "monday", index, scan)
    return empty


def test_a_drive_is_mounted_and_closed(driven):
    with admin_of(driven) as admin:
        mounted = admin.set_mounting("campus", "monday", Mounting(1.2, 0.0, 1.9, pitch_deg=5.0), 2)
        assert (mounted["mounting"]["pitch_deg"], mounted["accumulate"]) == (5.0, 2)
        assert admin.set_mounting("campus", "monday", None)["mounting"] is None
        assert admin.set_mounting("campus", "tuesday", None)["scans"] == 0  # it is created
        assert admin.close_drive("campus", "monday")["closed"]
        assert admin.close_drive("campus", "monday") == admin.drive("campus", "monday")
        again = driven.put(
            "/v1/maps/campus/drives/monday/scans/7",
            content=npy(np.ones((2000, 3), "<f4")),
            headers={"Content-Type": "application/vnd.tensormap.npy"},
        )
        assert again.json()["type"].endswith(DriveClosed.problem)
        with pytest.raises(InvalidArgument, match="wanted a Mounting"):
            admin.set_mounting("campus", "monday", {"z_m": 1.9})


def test_the_returns_of_a_scan_are_those_that_were_sent(driven):
    with admin_of(driven) as admin:
        returns_m = admin.returns_m("campus", "monday", 1)
        assert returns_m.shape == (len(recording().scans[1]), 3)


def test_poses_are_put_and_come_back_as_they_can_be_put_again(driven, monkeypatch):
    with admin_of(driven) as admin:
        poses = [
            {"scan": scan, "pose": np.array([scan, *AHEAD[1:]]), "timestamp_s": np.float64(scan)}
            for scan in range(3)
        ]
        put = admin.put_poses("campus", "monday", poses)
        assert (put["poses"]["set"], put["scans_with_pose"]) == (3, 3)
        found = list(admin.poses("campus", "monday"))
        assert [(one["scan"], one["pose"][0]) for one in found] == [(0, 0.0), (1, 1.0), (2, 2.0)]
        assert admin.put_poses("campus", "monday", found)["poses"]["replaced"] == 0
        path = "/v1/maps/campus/drives/monday/poses"
        in_pages = admin._pages(path, {"limit": 1}, items="poses", after="first")
        assert list(in_pages) == found
        with pytest.raises(InvalidPose):
            admin.put_poses("campus", "monday", [{"scan": 0, "pose": [0.0] * 7}])
        with pytest.raises(InvalidArgument, match="JSON"):
            admin.put_poses("campus", "monday", [{"scan": 0, "timestamp_s": float("nan")}])


def test_a_file_of_poses_is_put_in_each_format(driven, tmp_path):
    kitti, tum, csv = (tmp_path / name for name in ("poses.txt", "poses.tum", "poses.csv"))
    kitti.write_text("1 0 0 5 0 1 0 0 0 0 1 0\n" * 3)
    tum.write_text("".join(f"{scan}.5 6 0 0 0 0 0 1\n" for scan in range(3)))
    csv.write_text("scan,x,y,z,qx,qy,qz,qw\n1,7,0,0,0,0,0,1\n")
    with admin_of(driven) as admin:

        def x_m():
            return [one["pose"][0] for one in admin.poses("campus", "monday")]

        assert admin.put_pose_file("campus", "monday", kitti, "kitti")["poses"]["set"] == 3
        assert x_m() == [5.0] * 3
        admin.put_pose_file("campus", "monday", str(tum), "tum")
        assert x_m() == [6.0] * 3
        with pytest.raises(PosesDoNotFit):
            admin.put_pose_file("campus", "monday", csv, "csv")
        admin.put_pose_file("campus", "monday", csv, "csv", partial=True)
        assert x_m() == [6.0, 7.0, 6.0]
        kitti.write_text("1 0 0 8 0 1 0 0 0 0 1 0\n")
        admin.put_pose_file("campus", "monday", kitti, "kitti", first=2, partial=True)
        assert x_m() == [6.0, 7.0, 8.0]
        with pytest.raises(FileNotFoundError):
            admin.put_pose_file("campus", "monday", tmp_path / "none", "csv")


def test_captures_are_listed_and_deleted(empty, bag, tmp_path):
    (tmp_path / "monday.mcap").write_bytes(bag)
    with Mapper(HERE, None, "campus", connections=empty._transport) as mapper:
        assert mapper.upload(tmp_path / "monday.mcap", "monday").stored == 3
    with admin_of(empty) as admin:
        [listed] = admin.captures("campus")
        assert list(admin.captures("campus", "monday")) == [listed]
        assert admin.capture("campus", "monday", listed["capture"])["scans"]["stored"] == 3
        admin.delete_capture("campus", "monday", listed["capture"])
        assert not list(admin.captures("campus"))
        [job] = admin.jobs("campus", states=["done", "failed"])
        assert admin.job(job["job"]) == job
        assert not list(admin.jobs(states=["queued"]))


def test_a_revision_is_moved_to_another_map_by_its_file(own, built, tmp_path, monkeypatch):
    monkeypatch.setattr("tensormap_client._sync.download._PART_BYTES", 10_000)
    file = tmp_path / "campus.h5"
    with admin_of(own) as admin:
        admin.download_revision("campus", built.other, file)
        assert file.read_bytes() == own.get(f"/v1/maps/campus/revisions/{built.other}/file").content
        assert file.stat().st_size > 10_000  # so that there were several parts
        admin.create_map("yard")
        imported = admin.import_revision("yard", file)
        assert (imported["revision"], imported["live"]) == (built.other, True)
        assert admin.import_revision("yard", str(file))["revision"] == built.other
        admin.download_revision("campus", built.live, file)
        assert not admin.import_revision("yard", file)["live"]
        assert admin.import_revision("yard", file, make_live=True)["live"]
        other = admin.topology("yard", built.other)
        assert other["revision"] == built.other
        assert admin.topology("yard")["revision"] == built.live
        assert admin.comparison("yard", built.other, built.other)["other"] is not None
        file.write_bytes(b"no map")
        with pytest.raises(InvalidMap):
            admin.import_revision("yard", file)


def test_an_anchored_map_is_geojson(own):
    with admin_of(own) as admin:
        with pytest.raises(MapNotAnchored):
            admin.geojson("campus")
        anchor = {"latitude_deg": 49.01, "longitude_deg": 8.4}
        changed = admin.update_map("campus", {"description": "by the sea", "anchor": anchor})
        assert (changed["description"], changed["anchor"]["longitude_deg"]) == ("by the sea", 8.4)
        assert admin.geojson("campus")["type"] == "FeatureCollection"
        assert admin.update_map("campus", {"anchor": None})["description"] == "by the sea"


def test_a_basis_is_shared_used_by_a_build_and_removed(campus_of, tmp_path):
    data_dir = copy_of(campus_of(segments=3, encoding="harmonic"), tmp_path / "data")
    with running(data_dir) as client, admin_of(client) as admin:
        shared = admin.share_basis("city", ["campus"])
        assert admin.share_basis("city", ["campus"]) == shared
        assert [one["name"] for one in admin.bases()] == ["city"]
        with pytest.raises(BasisInUse):  # the revision that it was taken from has it
            admin.delete_basis("city")
        job = admin.build("campus", {"basis": "city"})
        assert client.get("/v1/maps/campus/basis").json()["basis"] == shared["basis"]
        assert job["plan"]["parameters"]["basis"] == "city"
        with pytest.raises(MapNotFound):
            admin.share_basis("town", ["nowhere"])
        with pytest.raises(InvalidArgument, match="maps is 'campus', wanted several"):
            admin.share_basis("town", "campus")
        admin.delete_map("campus", purge=True)
        admin.delete_basis("city")
        assert not list(admin.bases())


def test_what_was_deleted_is_restored_under_another_name_or_was_purged(driven):
    with admin_of(driven) as admin:
        admin.delete_drive("campus", "monday")
        [deleted] = admin.recycle_bin()
        assert admin.restore(deleted["entry"], "tuesday")["drive"] == "tuesday"
        admin.delete_drive("campus", "tuesday", purge=True)
        assert not list(admin.recycle_bin())
        with pytest.raises(DriveNotFound):
            admin.drive("campus", "tuesday")


def test_a_key_is_exchanged_for_a_token_with_fewer_rights(guarded):
    with admin_of(guarded, ADMIN_KEY) as admin:
        made = admin.make_key("a fleet", ["maps:read", "localize"])
        assert admin.key(made["key"])["name"] == "a fleet"
    with admin_of(guarded, made["secret"]) as holder:
        token = holder.exchange_token(["maps:read"], ["dock"], expires_in_s=60)
        assert (token["scopes"], token["maps"]) == (["maps:read"], ["dock"])
        assert holder.exchange_token()["scopes"] == ["localize", "maps:read"]
    with admin_of(guarded, token["secret"]) as limited:
        assert [one["map"] for one in limited.maps()] == ["dock"]
        with pytest.raises(ScopeMissing):
            limited.exchange_token()


def test_the_audit_log_is_filtered_and_its_newest_entry_is_first(guarded):
    with admin_of(guarded, ADMIN_KEY) as admin:
        for slug in ("east", "west"):
            admin.create_map(slug)
            admin.delete_map(slug)
        newest = list(itertools.islice(admin.audit(order="newest"), 2))
        assert [(act["action"], act["map"]) for act in newest] == [
            ("delete_map", "west"),
            ("create_map", "west"),
        ]
        chosen = {"actions": ["delete_map", "create_map"], "map_slug": "east", "key": "operator"}
        acts = list(admin.audit(**chosen))
        assert [act["action"] for act in acts] == ["create_map", "delete_map"]
        assert list(admin.audit(**chosen, order="newest")) == acts[::-1]
        assert list(admin.audit(**chosen, since=acts[1]["at"])) == acts[1:]
        assert list(admin.audit(**chosen, until=acts[1]["at"])) == acts[:1]
        assert list(admin.audit(**chosen, after=acts[0]["entry"])) == acts[1:]
        with pytest.raises(InvalidRequest, match="'create_map'"):
            list(admin.audit(actions=["make_map"]))
        with pytest.raises(InvalidArgument, match="wanted several"):
            admin.audit(actions="make_key")


def test_the_second_program_of_the_readme_administers_a_map(own, tmp_path, monkeypatch, capsys):
    text = (ROOT / "clients/python/README.md").read_text()
    [_, program] = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tensormap_client, "Admin", lambda _url, _key: admin_of(own))
    exec(program, {})
    assert capsys.readouterr().out == "put_drive campus done\n"
    assert (tmp_path / "campus.h5").stat().st_size > 10_000


def test_the_asynchronous_administrator_does_the_same(driven, tmp_path):
    async def administered():
        connections = ASGITransport(driven.app, client=("127.0.0.1", 5000))
        async with AsyncAdmin(HERE, connections=connections) as admin:
            await admin.put_poses("campus", "monday", [{"scan": 0, "pose": AHEAD}])
            poses = [one async for one in admin.poses("campus", "monday")]
            acts = [one async for one in admin.audit(actions=["put_poses"], order="newest")]
            return poses, acts

    poses, acts = asyncio.run(administered())
    assert poses[0]["pose"] == list(AHEAD)
    assert [one["action"] for one in acts] == ["put_poses"]
