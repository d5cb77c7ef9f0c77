"""Builds of drives that came without poses."""

from dataclasses import replace

import numpy as np
import pytest

from app.builds import stored_odometry
from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.builds.revision_build import build_revision
from core.odometry.odometry import compute_odometry
from core.scans.mounting import Mounting
from core.scans.pose import Pose, PoseSource, is_known, pose_rows
from core.scans.scan import Scan
from storage.catalog import ScanPoses
from storage.errors import ReturnsGone
from storage.files.map_file import read_map
from storage.retention import RawScans, Retention
from tests.support.odometry import needs_odometry
from tests.support.recording import recording
from tests.support.service import running

pytestmark = needs_odometry

SCANS = 8
PARAMETERS = BuildParameters(segments=2, encoding="paper")
DROPPED = Retention(raw_scans=RawScans.DROP)


@pytest.fixture
def store(store):
    put(store, range(SCANS))
    return store


def put(store, indices, drive="monday"):
    scans = [(at, replace(recording().scans[at], pose=None)) for at in indices]
    store.drives.put_scans("campus", drive, scans)


def built(store, parameters=PARAMETERS):
    """Build, and return the map, the drive and the notes of the job."""
    map_id = store.maps.get("campus").id
    job = store.jobs.create("campus", parameters.as_json())
    store.jobs.claim()
    plan = plan_build(store, map_id, parameters)
    record = build_revision(store, map_id, plan, job_id=job.id)
    tensor_map = read_map(store.revisions.path_of(record))
    return tensor_map, store.drives.get("campus", "monday"), store.jobs.get(job.id).notes, record


def test_a_build_computes_poses_once_and_stores_them_with_the_drive(store, monkeypatch):
    tensor_map, drive, notes, record = built(store)
    assert (drive.pose_source, drive.scans_with_pose) == (PoseSource.ODOMETRY, SCANS)
    assert tensor_map.trajectory.all_known
    assert any("drive monday: poses by odometry (kiss-icp" in note for note in notes)
    assert drive.odometry["parameters"]["sensor_height_m"] == 1.73
    assert record.parameters["odometry_of"] == {"monday": drive.odometry}
    kept = store.drives.poses(drive.id, 0, SCANS)
    assert np.array_equal(kept.poses, tensor_map.trajectory.poses)
    assert (np.diff(kept.sigmas[:, 0]) >= 0.0).all()
    with monkeypatch.context() as patch:
        patch.setattr(stored_odometry, "compute_odometry", None)  # it is not called
        again, *_ = built(store)
    assert again.revision == tensor_map.revision


def test_scans_of_too_few_returns_get_no_poses_and_a_note(store):
    few = [(at, Scan(recording().scans[at].points_m[:1])) for at in range(2)]
    store.drives.put_scans("campus", "few", few)
    drives, notes = stored_odometry.pose_stored(
        store, store.maps.get("campus").id, [store.drives.open("campus", "few")], 1.73
    )
    assert not is_known(drives[0].poses).any()
    assert notes == (
        "drive few has no poses, everything is in scan indices, no metres: odometry found none, 1"
        " of 2 scans do not fit those before them, or have too few returns",
    )


def test_scans_that_do_not_fit_are_noted_by_each_build_as_the_first_may_be_interrupted(store):
    put(store, [47], drive="monday")
    map_id = store.maps.get("campus").id
    wanted = "drive monday: 1 scan does not fit that before it, 47: is something missing?"
    for _ in range(2):  # the first one is killed before it publishes its notes
        drives = store.drives.open_of_map(map_id)
        _, notes = stored_odometry.pose_stored(store, map_id, drives, 1.73)
        assert sum(wanted in note for note in notes) == 1


def test_scans_that_show_hardly_any_motion_are_noted_with_both_reasons(store):
    first = replace(recording().scans[0], pose=None)
    shifted = [replace(first, points_m=first.points_m + np.float32(0.001 * at)) for at in range(4)]
    store.drives.put_scans("campus", "parked", list(enumerate(shifted)))
    _, notes = stored_odometry.pose_stored(
        store, store.maps.get("campus").id, [store.drives.open("campus", "parked")], 1.73
    )
    assert notes[0].startswith("drive parked: poses by odometry")
    assert "over 0" in notes[0]
    assert notes[0].endswith(
        ": the scans show hardly any motion: did the vehicle stand, or are they in the frame of a"
        " map, as clouds that SLAM has registered, and not in the sensor's?"
    )


def test_a_drive_that_got_more_scans_gets_new_poses(store):
    _, before, *_ = built(store)
    put(store, range(SCANS, SCANS + 2))
    tensor_map, drive, *_ = built(store)
    assert tensor_map.trajectory.all_known
    assert len(tensor_map) == drive.scans_with_pose == SCANS + 2
    assert drive.odometry["scans"] != before.odometry["scans"]


def test_poses_that_are_put_win_and_are_never_computed_again(store):
    built(store)
    given = {at: recording().pose(at) for at in range(SCANS)}
    store.drives.put_poses("campus", "monday", given)
    tensor_map, drive, notes, record = built(store)
    assert drive.pose_source == PoseSource.GIVEN
    assert tensor_map.trajectory.poses[3] == pytest.approx(given[3].as_tuple())
    assert not any("odometry" in note for note in notes)
    assert "odometry_of" not in record.parameters


def dropped(store):
    """Close the built drive, and drop the returns of its first scans."""
    store.drives.close("campus", "monday")
    live = store.maps.get("campus").live_revision
    drive = store.drives.open("campus", "monday")
    (images,) = store.drives.images_folder(drive.record).iterdir()
    store.drives.drop_returns(live, drive, images, [0, 1], DROPPED)


def stored_poses(store):
    drive = store.drives.get("campus", "monday")
    return drive.pose_source, store.drives.poses(drive.id, 0, SCANS).poses.tolist()


def in_a_file(store, poses, **options):
    rows = pose_rows([poses.get(at) for at in range(SCANS)])
    given = ScanPoses(np.arange(SCANS), rows, np.full(SCANS, np.nan))
    return store.drives.expect_poses("campus", "monday", given, **options)


def test_poses_that_take_the_place_of_computed_ones_are_counted(store):
    built(store)
    _, computed = stored_poses(store)
    same = store.drives.put_poses("campus", "monday", {0: Pose(*computed[0])})
    assert (same.set, same.replaced, same.forgotten) == (1, 0, SCANS - 1)
    store.drives.put_poses("campus", "monday", {0: None})
    built(store)
    given = {at: recording().pose(at) for at in range(1, SCANS)}
    put = in_a_file(store, given)
    assert (put.set, put.replaced, put.forgotten) == (SCANS - 1, SCANS - 1, 1)
    assert stored_poses(store)[0] == PoseSource.GIVEN


def test_an_unknown_pose_removes_the_computed_one_of_its_scan_and_no_other(store):
    built(store)
    put = store.drives.put_poses("campus", "monday", {3: None}, {4: 5.0})
    assert (put.set, put.replaced, put.forgotten) == (0, 0, 1)
    drive = store.drives.get("campus", "monday")
    assert (drive.pose_source, drive.scans_with_pose) == (PoseSource.ODOMETRY, SCANS - 1)
    kept = store.drives.poses(drive.id, 0, SCANS)
    assert np.flatnonzero(np.isnan(kept.sigmas[:, 0])).tolist() == [3]
    _, again, *_ = built(store)
    assert again.scans_with_pose == SCANS - 1


def test_where_no_computed_pose_is_left_they_are_computed_again(store):
    _, computed, *_ = built(store)
    store.drives.put_poses("campus", "monday", dict.fromkeys(range(SCANS)))
    drive = store.drives.get("campus", "monday")
    assert (drive.pose_source, drive.odometry, drive.scans_with_pose) == (PoseSource.GIVEN, None, 0)
    _, again, *_ = built(store)
    assert (again.odometry, again.scans_with_pose) == (computed.odometry, SCANS)


def test_computed_poses_that_cannot_be_computed_again_are_kept(store):
    built(store)
    dropped(store)
    before = stored_poses(store)
    given = {at: recording().pose(at) for at in range(SCANS)}
    for poses in ({0: given[0]}, {0: None}, {0: given[0], 3: None}):
        with pytest.raises(ReturnsGone, match="the returns of 2 of 8 scans"):
            store.drives.put_poses("campus", "monday", poses)
    with pytest.raises(ReturnsGone, match="1 computed pose"):
        in_a_file(store, {at: given[at] for at in range(1, SCANS)}, partial=True)
    assert stored_poses(store) == before
    assert store.drives.put_poses("campus", "monday", {}, {3: 5.0}).forgotten == 0
    assert store.drives.put_poses("campus", "monday", given).forgotten == 0
    assert stored_poses(store)[0] == PoseSource.GIVEN


def test_the_vehicle_of_a_mounted_sensor_is_on_the_ground(store):
    store.drives.put("campus", "monday", Mounting(1.0, 0.0, 1.73, yaw_deg=90.0), 1)
    tensor_map, drive, *_ = built(store)
    poses = tensor_map.trajectory.poses
    assert np.abs(poses[:, 2] + 1.73).max() < 0.1
    assert drive.odometry["parameters"]["sensor_height_m"] == 1.73


@pytest.mark.parametrize(
    "why", ["not requested", "not installed", "returns are gone", "nothing fits"]
)
def test_without_odometry_a_map_is_in_scan_indices_and_a_note_says_why(store, why, monkeypatch):
    parameters, wanted = PARAMETERS, "too few scans for a calibration"
    if why == "not requested":
        parameters = BuildParameters(segments=2, encoding="paper", odometry=False)
    elif why == "not installed":
        monkeypatch.setattr(stored_odometry, "library_version", lambda: None)
        wanted = (
            "in scan indices, no metres: put poses, or install the extra `odometry`, which computes"
            " missing poses: `pip install ./clients/python '.[odometry]'` in the clone of the"
            " service"
        )
    elif why == "nothing fits":
        put(store, [47], drive="monday")
        monkeypatch.setattr(
            stored_odometry,
            "compute_odometry",
            lambda *given: replace(compute_odometry(*given), lost=tuple(range(5))),
        )
        wanted = "5 of 9 scans do not fit those before them"
    else:
        built(store, BuildParameters(segments=2, encoding="paper", odometry=False))
        dropped(store)
        wanted = "those of 2 of 8 were dropped"
    tensor_map, drive, notes, _ = built(store, parameters)
    assert not tensor_map.trajectory.known.any()
    assert (drive.pose_source, drive.odometry) == (PoseSource.GIVEN, None)
    assert any(wanted in note for note in notes)
    assert len(notes) == (1 if why == "not requested" else 2)


def test_a_service_that_cannot_compute_poses_logs_so_once_at_its_start(
    tmp_path, monkeypatch, caplog
):
    monkeypatch.setattr(stored_odometry, "library_version", lambda: None)
    with caplog.at_level("INFO", logger="tensormap.jobs"), running(tmp_path / "data"):
        pass
    assert (
        caplog.text.count("install the extra `odometry`, which computes missing poses: `pip ") == 1
    )


@pytest.mark.parametrize("change", ["another scan", "poses", "nothing"])
def test_a_drive_that_changes_while_its_poses_are_computed_has_some_in_the_map(
    store, change, monkeypatch
):
    given = {at: recording().pose(at) for at in range(SCANS)}

    def changing(*computing):
        if change == "another scan":
            put(store, [SCANS])
        elif change == "poses":
            store.drives.put_poses("campus", "monday", given)
        return compute_odometry(*computing)

    monkeypatch.setattr(stored_odometry, "compute_odometry", changing)
    tensor_map, drive, notes, _ = built(store)
    assert tensor_map.trajectory.known.sum() == drive.scans_with_pose == SCANS
    wanted = {
        "another scan": "1 of 9 scans has no pose: build again",
        "poses": "it was changed while odometry computed its poses: they are not used",
        "nothing": "poses by odometry",
    }
    assert any(wanted[change] in note for note in notes)
    source = PoseSource.GIVEN if change == "poses" else PoseSource.ODOMETRY
    assert drive.pose_source == source


def test_newer_scans_without_a_pose_are_counted_where_odometry_cannot_be_repeated(
    store, monkeypatch
):
    built(store)
    put(store, [SCANS])
    monkeypatch.setattr(stored_odometry, "library_version", lambda: None)
    tensor_map, _, notes, _ = built(store)
    assert tensor_map.trajectory.known.sum() == SCANS
    assert any("1 of 9 scans has no pose: put poses" in note for note in notes)
    assert not any("scan indices" in note for note in notes)
