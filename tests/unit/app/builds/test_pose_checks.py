"""Builds of drives whose given poses are not those of their scans."""

from dataclasses import replace

import numpy as np
import pytest

from app.builds import pose_checks
from app.builds.parameters import Align
from app.builds.pose_checks import check_recorded, check_stored
from core.errors import PosesContradictScans
from core.odometry.pose_check import check_poses
from core.odometry.posed_drive import PosedDrive
from core.scans.displacement import pose_beside
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from tests.support.recording import recording
from tests.support.registered import registered

SCANS = 24


@pytest.fixture
def store(store):
    store.drives.put_scans("campus", "monday", list(enumerate(recording().scans[:SCANS])))
    return store


def check(store, align=Align.CHECK):
    return check_stored(store, [store.drives.open("campus", "monday")], 1.73, align)


def put_reversed(store):
    poses = {at: recording().pose(SCANS - 1 - at) for at in range(SCANS)}
    store.drives.put_poses("campus", "monday", poses)


def stored(store):
    return store.drives.get("campus", "monday").pose_check


def test_right_poses_are_checked_once_and_anew_when_others_are_put(store, monkeypatch):
    assert check(store) == ()
    assert stored(store)["agreeing"] >= 3
    assert stored(store)["contradictions"] == []
    with monkeypatch.context() as patch:
        patch.setattr(pose_checks, "check_poses", None)  # it is not called
        assert check(store) == ()
    put_reversed(store)
    assert stored(store) is None
    with pytest.raises(PosesContradictScans):
        check(store)


@pytest.mark.parametrize(
    "change",
    [
        put_reversed,
        lambda store: store.drives.put_poses("campus", "monday", {3: None}),
        lambda store: store.drives.put_scan("campus", "monday", SCANS, recording().scans[SCANS]),
    ],
    ids=["put", "removed", "of a new scan"],
)
def test_a_check_is_not_stored_if_poses_were_changed_meanwhile(store, monkeypatch, change):
    def check_while_changed(*args):
        found = check_poses(*args)
        change(store)
        return found

    monkeypatch.setattr(pose_checks, "check_poses", check_while_changed)
    assert check(store) == ()  # of the poses that the build has
    assert stored(store) is None


def test_wrong_poses_fail_with_the_evidence_and_are_noted_where_they_are_wanted(store):
    put_reversed(store)
    for _ in range(2):  # the second one is the stored check
        with pytest.raises(PosesContradictScans, match=r"monday contradict its poses, 4 of 4 pair"):
            check(store)
    assert len(stored(store)["contradictions"]) == 4
    [note] = check(store, Align.OFF)
    assert "0 deg by the poses, (3.0, 0.0, 0.0) m and 0 deg by the scans" in note


def test_a_part_of_wrong_poses_is_noted(store):
    poses = {at: recording().pose(5 - at) for at in range(6)}
    store.drives.put_poses("campus", "monday", poses)
    [note] = check(store)
    assert "pairs: (forward, left, up) from scan 0 to 2: (-3.0, 0.0, 0.0) m and" in note
    assert note.endswith("is a part of the poses wrong, or late?")


def test_scans_in_the_frame_of_their_poses_fail_and_the_reason_names_the_frame(store):
    scans = [(at, registered(scan)) for at, scan in enumerate(recording().scans[:SCANS])]
    store.drives.put_scans("campus", "slam", scans)
    drive = store.drives.open("campus", "slam")
    reason = "scans of drive slam are in the frame of its poses.* wanted are scans in the sensor's"
    with pytest.raises(PosesContradictScans, match=reason):
        check_stored(store, [drive], 1.73, Align.CHECK)
    drive = store.drives.open("campus", "slam")
    assert drive.pose_check["in_map_frame"]
    [note] = check_stored(store, [drive], 1.73, Align.OFF)  # of the stored check
    assert "transform them back" in note


def test_returns_that_were_dropped_are_not_needed_again(store, monkeypatch):
    check(store)
    drive = store.drives.open("campus", "monday")
    drive.has_returns = np.zeros(SCANS, bool)
    monkeypatch.setattr(store.drives, "open", lambda *_: drive)
    assert check(store) == ()
    drive.pose_check = None
    [note] = check(store)
    assert "monday fit its scans could not be checked: their returns were dropped" in note


def test_recorded_drives_are_checked_likewise():
    drive = MemoryDrive("monday", recording().scans[:SCANS])
    assert check_recorded(drive, 1.73, Align.CHECK) == ()
    assert check_recorded(PosedDrive(drive, np.full((SCANS, 7), np.nan)), 1.73, Align.CHECK) == ()
    with pytest.raises(PosesContradictScans):
        check_recorded(PosedDrive(drive, drive.poses[::-1].copy()), 1.73, Align.AUTO)


def put_scaled(store, scale):
    poses = {
        at: replace(pose, x_m=scale * pose.x_m, y_m=scale * pose.y_m)
        for at, pose in enumerate(map(recording().pose, range(SCANS)))
    }
    store.drives.put_poses("campus", "monday", poses)


def test_poses_of_another_scale_are_noted_with_the_scale(store):
    put_scaled(store, 1.2)
    for _ in range(2):  # the second one is the stored check
        [note] = check(store)
        assert note.startswith("the poses of drive monday say 1.2")
        assert "times as far as its scans" in note


def test_poses_that_go_another_way_than_the_scans_are_noted_with_the_angle(store):
    turned = {
        at: Pose.from_row(pose_beside(np.array(recording().pose(at).as_tuple()), 0.0, 20.0))
        for at in range(SCANS)
    }
    store.drives.put_poses("campus", "monday", turned)
    for _ in range(2):  # the second one is the stored check
        [note] = check(store)
        assert note.startswith("the poses of drive monday go 20 degrees to the right of the way")


def test_the_scale_is_checked_too_where_an_earlier_release_checked_the_rest(store):
    put_scaled(store, 1.2)
    check(store)
    drive = store.drives.open("campus", "monday")
    earlier = {name: of for name, of in stored(store).items() if name != "scale"}
    store.drives.set_pose_check(drive.id, drive.scan_poses, earlier)
    assert len(check(store)) == 1
    store.drives.set_pose_check(drive.id, drive.scan_poses, earlier)
    drive = store.drives.open("campus", "monday")
    drive.has_returns = np.zeros(SCANS, bool)
    assert check_stored(store, [drive], 1.73, Align.CHECK) == ()


@pytest.mark.parametrize(("name", "of"), [("in_map_frame", False), ("turned_deg", None)])
def test_what_an_earlier_release_did_not_check_is_checked_too(store, name, of):
    check(store)
    drive = store.drives.open("campus", "monday")
    earlier = {key: value for key, value in stored(store).items() if key != name}
    store.drives.set_pose_check(drive.id, drive.scan_poses, earlier)
    assert check(store) == ()
    assert stored(store)[name] is of
