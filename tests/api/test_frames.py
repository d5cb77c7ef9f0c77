"""Drives in another world frame, and the gate before live."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.scans.pose import Pose, pose_rows
from core.scans.scan import Scan
from storage.catalog import ScanPoses
from tests.support.campus import MAP
from tests.support.recording import TAR, Recording, kitti, recording, tar, upload_scan
from tests.support.service import copy_of, problem_of, running, upload, wait_for

# Full views without renderings are built and compared faster, and nothing here depends on either:
# the drives pass the same places.
PARAMETERS = {"segments": 3, "views": "full", "lateral_renderings_m": [0.0]}
ADDED = {"base": "live", "add": ["tuesday"], "make_live": True}


def moved(drive, *, turn_deg=0.0, x_m=0.0):
    """Return a drive as another survey would place it."""
    turn = Rotation.from_euler("z", turn_deg, degrees=True)
    scans = []
    for scan in drive.scans:
        x, y, z, *quaternion = scan.pose.as_tuple()
        place = turn.apply([x, y, z]) + np.array([x_m, 0.0, 0.0])
        pose = Pose(*place, *(turn * Rotation.from_quat(quaternion)).as_quat())
        scans.append(Scan(scan.points_m, scan.timestamp_s, pose))
    return Recording(tuple(scans))


def found(client):
    """Return how many of 16 scans of a third drive are localized where they are."""
    return sum(is_found(client, scan) for scan in recording(noise_seed=3).scans[::3])


def is_found(client, scan):
    found = client.post(
        f"{MAP}/localizations/scan",
        content=kitti(scan),
        headers={"Content-Type": "application/vnd.tensormap.kitti"},
    ).json()
    place = found["matches"][0]["pose"]
    apart_m = np.hypot(place["x_m"] - scan.pose.x_m, place["y_m"] - scan.pose.y_m)
    return bool(found["localized"] and apart_m <= 5.0)


def build(client, **parameters):
    queued = client.post(f"{MAP}/builds", json=parameters)
    assert queued.status_code == 202, queued.text
    return wait_for(client, queued.json()["job"])


def live(client):
    return client.get(MAP).json()["live_revision"]


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """A live map of one drive."""
    data_dir = tmp_path_factory.mktemp("frames") / "data"
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording())
        assert build(client, **PARAMETERS)["state"] == "done"
    return data_dir


@pytest.fixture
def campus(mapped, tmp_path):
    with running(copy_of(mapped, tmp_path / "data")) as client:
        yield client


@pytest.fixture(scope="module")
def mapped_twice(mapped, tmp_path_factory):
    """The same with a second drive of the same streets, whose images are made."""
    data_dir = copy_of(mapped, tmp_path_factory.mktemp("twice") / "data")
    with running(data_dir) as client:
        upload(client, "tuesday", recording(noise_seed=1))
        assert build(client, drives=["tuesday"], **PARAMETERS)["state"] == "done"
    return data_dir


@pytest.fixture
def twice(mapped_twice, tmp_path):
    """The live map of `monday`, and `tuesday`, which a build adds without making its images."""
    with running(copy_of(mapped_twice, tmp_path / "data")) as client:
        yield client


def put_poses(client, drive, placed):
    poses = [
        {"scan": i, "timestamp_s": scan.timestamp_s, "pose": scan.pose.as_tuple()}
        for i, scan in enumerate(placed.scans)
    ]
    put = client.put(f"{MAP}/drives/{drive}/poses", json={"poses": poses})
    assert put.status_code == 200, put.text


@pytest.fixture
def foreign(twice):
    """The second drive is in another world frame."""
    put_poses(twice, "tuesday", moved(recording(noise_seed=1), turn_deg=30.0, x_m=500.0))
    return twice


def test_a_second_drive_in_another_world_frame_does_not_reach_the_map(foreign):
    before, was_live = found(foreign), live(foreign)
    job = build(foreign, **ADDED)
    after = found(foreign)
    assert (before, after, job["state"]) == (16, 16, "failed")
    assert job["error"]["type"] == "/problems/frames-disagree"
    for evidence in ("tuesday", "monday", "m away"):
        assert evidence in job["error"]["detail"]
    assert turned_deg(job["error"]["detail"]) == pytest.approx(-30.0, abs=0.5)
    assert live(foreign) == was_live


def test_a_drive_in_another_frame_is_aligned_on_request_and_stays_aligned(foreign):
    stored = foreign.get(f"{MAP}/drives/tuesday/poses").json()["poses"]
    job = build(foreign, **ADDED, align="auto")
    assert (job["state"], job["gate"]["live"]) == ("done", True)
    assert job["gate"]["recall"] >= job["gate"]["recall_of_live"] - 0.02
    assert found(foreign) == 16
    (note,) = job["notes"]
    assert turned_deg(note) == pytest.approx(-30.0, abs=0.5)
    assert foreign.get(f"{MAP}/drives/tuesday/poses").json()["poses"] == stored
    revision = foreign.get(f"{MAP}/revisions/{job['revision']}").json()
    placement = revision["parameters"]["placements"]["tuesday"]
    assert placement["others"] == ["monday"]
    assert placement["error_m"] < 0.5
    again = build(foreign, base="live", refit=True)  # checks, with the transform of its base
    assert (again["state"], again["notes"]) == ("done", [])
    kept = foreign.get(f"{MAP}/revisions/{again['revision']}").json()["parameters"]["placements"]
    assert kept == {"tuesday": placement}


def test_a_build_on_a_base_checks_the_frames_of_drives_that_are_new_or_have_other_poses(twice):
    assert build(twice, **ADDED)["state"] == "done"

    def confirmed():
        revision = twice.get(f"{MAP}/revisions/{live(twice)}").json()
        return revision["parameters"]["confirmed_frames"]

    def planned(**parameters):
        return build(twice, base="live", **parameters)["plan"]["confirmed_frames"]

    assert set(confirmed()) == {"monday", "tuesday"}
    assert planned(refit=True) == confirmed()
    assert set(planned(remove=["tuesday"])) == {"monday"}
    # Another drive under that name was never matched, and one that is added again is read anew.
    assert set(planned(add=["tuesday"])) == {"monday"}
    assert twice.delete(f"{MAP}/drives/tuesday").status_code == 204
    upload(twice, "tuesday", recording(noise_seed=2))
    assert set(planned(refit=True)) == {"monday"}
    assert planned(refit=True, align="auto") == {}  # a check accepts what an alignment corrects
    put_poses(twice, "monday", moved(recording(), x_m=20.0))
    job = build(twice, base="live", refit=True)
    assert set(job["plan"]["confirmed_frames"]) == {"monday"}  # its digest is of other poses
    assert job["error"]["type"] == "/problems/frames-disagree"


@pytest.mark.parametrize(("poses", "align"), [("unchecked", "off"), ("checked", "check")])
def test_a_body_of_an_earlier_release_is_read_as_it_was_meant(campus, poses, align):
    queued = campus.post(f"{MAP}/builds", json={"base": "live", "refit": True, "poses": poses})
    parameters = campus.get(f"/v1/jobs/{queued.json()['job']}").json()["parameters"]
    assert (parameters["align"], parameters["poses"]) == (align, poses)
    wait_for(campus, queued.json()["job"])
    other = {"off": "check", "check": "off"}[align]
    contradicting = {"base": "live", "refit": True, "poses": poses, "align": other}
    assert problem_of(campus.post(f"{MAP}/builds", json=contradicting)) == (422, "invalid-request")


def test_poses_that_a_build_computed_are_aligned_without_a_request(campus):
    scans = moved(recording(noise_seed=1), turn_deg=-70.0, x_m=90.0).scans
    files = tar((f"{index:06}.bin", kitti(scan)) for index, scan in enumerate(scans))
    sent = campus.post(
        f"{MAP}/drives/tuesday/scans", content=files, headers=TAR, params={"format": "kitti"}
    )
    assert sent.status_code == 200, sent.text
    drives = campus.service.store.drives
    unknown, sigmas = np.full(len(scans), np.nan), np.full((len(scans), 2), 0.1)
    poses = pose_rows([scan.pose for scan in scans])
    computed = ScanPoses(np.arange(len(scans)), poses, unknown, sigmas)
    tuesday = drives.get("campus", "tuesday").id
    assert drives.set_computed_poses(tuesday, computed, {"registration": "a test"})
    job = build(campus, **ADDED, odometry=False)
    assert (job["state"], job["gate"]["live"]) == ("done", True)
    [note] = [note for note in job["notes"] if "were turned by" in note]
    assert turned_deg(note) == pytest.approx(70.0, abs=0.5)
    assert found(campus) == 16
    # Poses in the frame of the map are put: the computed ones were transformed, these are not.
    surveyed = recording(noise_seed=1)
    rows = [{"scan": at, "pose": list(surveyed.pose(at).as_tuple())} for at in range(len(scans))]
    assert campus.put(f"{MAP}/drives/tuesday/poses", json={"poses": rows}).status_code == 200
    again = build(campus, base="live", refit=True, make_live=True)
    assert again["state"] == "done", again["error"]
    assert any("the transform is not applied" in note for note in again["notes"])
    revision = campus.get(f"{MAP}/revisions/{again['revision']}").json()
    assert revision["parameters"]["placements"] == {}
    assert found(campus) == 16


def test_a_drive_that_is_moved_by_20_metres_is_refused_too(twice):
    put_poses(twice, "tuesday", moved(recording(noise_seed=1), x_m=20.0))
    assert build(twice, **ADDED)["error"]["type"] == "/problems/frames-disagree"


@pytest.mark.parametrize("x_m", [0.0, 2.0])
def test_a_drive_in_the_same_frame_is_added_without_a_note_and_measured(twice, x_m):
    put_poses(twice, "tuesday", moved(recording(noise_seed=1), x_m=x_m))
    was_live = live(twice)
    job = build(twice, **ADDED)
    assert (job["state"], job["notes"]) == ("done", [])
    gate = job["gate"]
    assert (gate["live"], gate["compared_with"], gate["reason"]) == (True, was_live, None)
    assert gate["asked"] > 20
    assert gate["recall"] >= gate["recall_of_live"] - 0.02
    assert live(twice) == job["revision"]
    assert found(twice) == 16


def test_a_drive_without_poses_has_no_frame_to_check(campus):
    for index, scan in enumerate(recording(noise_seed=1).scans[:12]):
        upload_scan(campus, "campus", "tuesday", index, scan)
    job = build(campus, base="live", add=["tuesday"])
    assert job["state"] == "done"
    assert not any("world frame" in note for note in job["notes"])
    assert job["gate"] is None


def test_a_build_that_does_not_check_frames_is_not_live_if_its_recall_is_lower(foreign):
    was_live = live(foreign)
    job = build(foreign, **ADDED, align="off")
    assert job["state"] == "done"
    gate = job["gate"]
    assert gate["live"] is False
    assert gate["compared_with"] == was_live
    assert gate["recall"] < gate["recall_of_live"] - 0.02
    assert gate["reason"] in job["notes"]
    assert "not made live" in gate["reason"]
    assert live(foreign) == was_live
    put = foreign.put(f"{MAP}/live", json={"revision": job["revision"]})  # is never gated
    assert put.status_code == 200
    assert live(foreign) == job["revision"]


@pytest.mark.parametrize("insisting", [{"force": True}, {"max_recall_loss": 1.0}])
def test_a_loss_of_recall_can_be_accepted(foreign, insisting):
    job = build(foreign, **ADDED, align="off", **insisting)
    assert (job["state"], job["gate"]["live"]) == ("done", True)
    assert live(foreign) == job["revision"]


@pytest.mark.parametrize("option", [{"force": True}, {"max_recall_loss": 1.0}])
@pytest.mark.parametrize("live", [{}, {"make_live": False}])
def test_an_option_of_make_live_is_refused_without_it(campus, option, live):
    body = {"drives": ["monday"], **option, **live}
    answer = campus.post(f"{MAP}/builds", json=body)
    (name,) = option
    assert (answer.status_code, answer.json()["type"]) == (422, "/problems/invalid-request")
    [fault] = answer.json()["errors"]
    assert fault["where"] == f"body/{name}"
    assert f"{name} only applies with make_live: true" in fault["what"]


def test_the_defaults_of_a_job_may_be_sent_again(campus):
    job = build(campus, base="live", refit=True)
    parameters = campus.get(f"/v1/jobs/{job['job']}").json()["parameters"]
    defaults = {name: parameters[name] for name in ("force", "max_recall_loss", "make_live")}
    assert build(campus, drives=["monday"], **PARAMETERS, **defaults)["state"] == "done"


def test_align_off_is_not_inherited_by_the_next_build(foreign):
    job = build(foreign, **ADDED, align="off", force=True)
    parameters = foreign.get(f"/v1/jobs/{job['job']}").json()["parameters"]
    assert (parameters["align"], parameters["force"]) == ("off", True)
    again = build(foreign, base="live", refit=True)
    assert again["error"]["type"] == "/problems/frames-disagree"


def test_the_first_build_of_a_map_is_live_and_one_of_another_drive_is_compared_with_it(campus):
    campus.post("/v1/maps", json={"map": "other"})
    upload(campus, "monday", recording(), slug="other")
    queued = campus.post("/v1/maps/other/builds", json={**PARAMETERS, "make_live": True}).json()
    gate = wait_for(campus, queued["job"])["gate"]
    assert (gate["live"], gate["compared_with"], gate["reason"]) == (True, None, None)
    upload(campus, "tuesday", recording(noise_seed=1))
    job = build(campus, drives=["tuesday"], **PARAMETERS, make_live=True)
    gate = job["gate"]  # of another drive alone: that is compared with what the live one finds
    assert (gate["live"], gate["recall_unknown"], gate["reason"]) == (True, "no-scan-in-both", None)
    assert gate["asked_new"] > 20
    assert gate["recall_of_new"] >= gate["recall_of_live"] - 0.05


def test_a_new_drive_that_the_map_does_not_find_is_not_made_live(campus):
    good = recording(noise_seed=1).scans
    streets = [good[i].points_m for i in np.random.default_rng(1).permutation(len(good))]
    mixed = [Scan(p, s.timestamp_s, s.pose) for p, s in zip(streets, good, strict=True)]
    upload(campus, "tuesday", Recording(tuple(mixed)))
    was_live = live(campus)
    job = build(campus, **ADDED, poses="unchecked", max_recall_loss=0.04)
    gate = job["gate"]
    assert (job["state"], gate["live"]) == ("done", False)
    assert gate["asked_new"] > 20
    assert gate["recall_of_new"] < gate["recall_of_live"] - 0.05
    assert live(campus) == was_live


@pytest.mark.parametrize("force", [False, True])
def test_a_build_whose_recall_cannot_be_measured_is_live_only_if_it_is_forced(campus, force):
    data = campus.service.store.layout.data_dir
    upload(campus, "tuesday", recording(noise_seed=1))
    for images in data.rglob("images/*.h5"):
        images.unlink()
    job = build(campus, drives=["tuesday"], **PARAMETERS, make_live=True, force=force)
    assert (job["state"], job["gate"]["live"]) == ("done", force)
    if not force:
        assert job["gate"]["reason"] in job["notes"]
        assert "images-not-kept; force makes it live" in job["gate"]["reason"]


def test_an_import_reports_the_recall_that_a_build_would_be_measured_by(campus):
    revisions, kind = f"{MAP}/revisions", {"Content-Type": "application/vnd.tensormap.map+hdf5"}
    worse = build(campus, **PARAMETERS, ranks=[1, 1], make_live=True)
    file = campus.get(f"{revisions}/{worse['revision']}/file").content
    campus.delete(f"{revisions}/{worse['revision']}")
    imported = campus.post(revisions, content=file, headers=kind).json()
    for figure in ("compared_with", "asked", "recall", "recall_of_live"):
        assert imported["gate"][figure] == worse["gate"][figure], figure
    assert imported["gate"]["reason"] in worse["gate"]["reason"]
    again = campus.post(revisions, content=file, headers=kind, params={"make_live": True}).json()
    assert (again["live"], again["gate"]["live"]) == (True, True)  # a request is not gated
    back = build(campus, **PARAMETERS, make_live=True)  # than an imported live one
    assert (back["gate"]["live"], back["gate"]["asked"]) == (True, worse["gate"]["asked"])


def test_unused_poses_are_noted_by_a_build(twice):
    lines = "".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(2))
    kind = {"Content-Type": "application/vnd.tensormap.poses.kitti"}
    put = twice.put(
        f"{MAP}/drives/tuesday/poses",
        content=lines,
        headers=kind,
        params={"first": 48, "partial": True},
    )
    assert put.json()["poses"]["waiting"] == 2
    (note,) = build(twice, **ADDED)["notes"]
    assert "drive tuesday has 2 poses of scans that it lacks" in note


@pytest.mark.parametrize("remove", ["delete", "put"])
def test_a_mistyped_drive_that_has_poses_only_is_left_out_of_a_build_with_a_note(campus, remove):
    lines = "".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(2))
    kind = {"Content-Type": "application/vnd.tensormap.poses.kitti"}
    mistyped = f"{MAP}/drives/mondya"
    assert campus.put(f"{mistyped}/poses", content=lines, headers=kind).status_code == 200
    (note,) = build(campus, **PARAMETERS)["notes"]
    assert note == (
        "drive mondya is left out, it has no scans, 2 poses wait for them: is its name mistyped?"
    )
    for named in ({"drives": ["monday", "mondya"]}, {"base": "live", "add": ["mondya"]}):
        refused = campus.post(f"{MAP}/builds", json=named)
        assert problem_of(refused) == (422, "empty-drive")
        assert "drive 'mondya' has no scan" in refused.json()["detail"]
    if remove == "delete":
        assert campus.delete(mistyped).status_code == 204
        assert build(campus, **PARAMETERS)["notes"] == []
    else:
        unknown = f"{'nan ' * 12}\n" * 2
        put = campus.put(f"{mistyped}/poses", content=unknown, headers=kind).json()
        assert put["poses_waiting"] == 0


def test_a_map_whose_drives_have_no_scans_is_not_built(campus):
    campus.post("/v1/maps", json={"map": "other"})
    kind = {"Content-Type": "application/vnd.tensormap.poses.kitti"}
    line = "1 0 0 0 0 1 0 0 0 0 1 0\n"
    campus.put("/v1/maps/other/drives/monday/poses", content=line, headers=kind)
    refused = campus.post("/v1/maps/other/builds", json={})
    assert problem_of(refused) == (422, "empty-drive")
    assert "upload scans first" in refused.json()["detail"]


def turned_deg(text):
    """Return the rotation that a note on drive tuesday states."""
    assert "tuesday" in text
    [angle] = re.findall(r"turned by (\S+) deg about", text)
    return float(angle)
