"""Files of poses, before and after their scans."""

import numpy as np
import pytest

from app.drives.pose_files import CSV, KITTI, TUM
from core.scans.pose import Pose
from tests.support.catalog_rows import stored_scans
from tests.support.recording import recording, upload_scan
from tests.support.service import pose_text, problem_of, wait_for, whole_store

DRIVE = "/v1/maps/campus/drives/monday"
SCANS = recording(scans=4).scans
# Turned to the left by 90 degrees, at (1, 2, 3); unknown; ahead, at (4, 5, 6).
KITTI_LINES = f"0 -1 0 1 1 0 0 2 0 0 1 3\n{'nan ' * 12}\n1 0 0 4 0 1 0 5 0 0 1 6\n"
HALF = 0.5**0.5


@pytest.fixture
def empty(emptied):
    return emptied


def put(client, body, kind, **params):
    return client.put(f"{DRIVE}/poses", content=body, headers={"Content-Type": kind}, params=params)


def records(client):
    return stored_scans(client.service.store, "campus", "monday")


def same(pose, *expected):
    np.testing.assert_allclose(pose.as_tuple(), expected, atol=1e-12)


@pytest.mark.parametrize("when", ["before", "after", "between"])
def test_kittis_poses_are_those_of_scans_that_are_in_and_to_come(empty, when):
    early = {"before": 0, "between": 1, "after": 3}[when]
    for index in range(early):
        upload_scan(empty, "campus", "monday", index, SCANS[index])
    answer = put(empty, KITTI_LINES, KITTI, partial=when == "between")
    assert (answer.status_code, answer.json()["scans"]) == (200, early)
    stored = [upload_scan(empty, "campus", "monday", i, SCANS[i]).json() for i in range(early, 3)]
    assert [item["has_pose"] for item in stored] == [True, False, True][early:]
    rotated, unknown, ahead = records(empty)
    same(rotated.pose, 1, 2, 3, 0, 0, HALF, HALF)
    assert unknown.pose is None
    same(ahead.pose, 4, 5, 6, 0, 0, 0, 1)


def test_tums_lines_have_times_and_begin_at_the_given_scan(empty):
    upload_scan(empty, "campus", "monday", 2, SCANS[2])
    body = "# t x y z qx qy qz qw\n10.5 1 2 3 0 0 0 1\n\n11.5 4 5 6 0 0 1 0 # rotated\n"
    put(empty, body, TUM, first=2, partial=True)
    upload_scan(empty, "campus", "monday", 3, SCANS[3])
    second, third = records(empty)
    assert (second.index, second.timestamp_s, third.index, third.timestamp_s) == (2, 10.5, 3, 11.5)
    same(second.pose, 1, 2, 3, 0, 0, 0, 1)
    same(third.pose, 4, 5, 6, 0, 0, 1, 0)


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        (CSV, "scan,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n"),
        ("application/json", '{"poses": [{"scan": 0, "pose": [1, 2, 3, 0, 0, 0, 1]}]}'),
    ],
    ids=["table", "json"],
)
def test_the_scan_of_the_first_line_is_refused_beside_poses_that_name_their_scans(
    empty, kind, body
):
    upload_scan(empty, "campus", "monday", 0, SCANS[0])
    before = whole_store(empty)
    refused = put(empty, body, kind, first=2)
    assert problem_of(refused) == (422, "invalid-parameters")
    assert "first is 2" in refused.json()["detail"]
    assert whole_store(empty) == before
    assert put(empty, body, kind, first=0).status_code == 200  # as `/docs` sends it


def test_a_table_names_its_scans(empty):
    upload_scan(empty, "campus", "monday", 0, SCANS[0])
    body = "x,y,z,qw,qx,qy,qz,scan,timestamp_s\r\n7,8,9,1,0,0,0,3,3.5\r\n1,2,3,1,0,0,0,0,\r\n"
    put(empty, body, CSV, partial=True)
    upload_scan(empty, "campus", "monday", 3, SCANS[3])
    first, last = records(empty)
    assert np.isnan(first.timestamp_s)
    assert last.timestamp_s == 3.5
    same(first.pose, 1, 2, 3, 0, 0, 0, 1)
    same(last.pose, 7, 8, 9, 0, 0, 0, 1)


def test_a_stored_scan_that_comes_with_another_pose_or_time_is_noted_and_keeps_its_own(empty):
    own, other = Pose(1.0, 2.0, 3.0, 0.0, 0.0, HALF, HALF), Pose(9.0, 9.0, 9.0)

    def notes_of(status=200, **params):
        answer = upload_scan(empty, "campus", "monday", 0, SCANS[0], params=params)
        assert answer.status_code == status
        return [note.split()[0] for note in answer.json()["notes"]]

    first = {"pose": pose_text(own), "timestamp_s": 7.5}
    assert notes_of(201, **first) == notes_of(**first) == notes_of() == []
    assert notes_of(pose=pose_text(other)) == ["pose"]
    assert notes_of(pose=pose_text(other), timestamp_s=0.0) == ["timestamp_s", "pose"]
    (record,) = records(empty)
    same(record.pose, *own.as_tuple())
    assert record.timestamp_s == 7.5


def test_a_scan_keeps_its_own_pose_and_a_later_file_that_of_an_earlier_one(empty):
    put(empty, "1 1 1 1 0 0 0 1\n2 2 2 2 0 0 0 1\n", TUM)
    put(empty, "5 5 5 5 0 0 0 1\n", TUM)
    own = Pose(9.0, 9.0, 9.0)
    upload_scan(empty, "campus", "monday", 0, SCANS[0], params={"pose": pose_text(own)})
    upload_scan(empty, "campus", "monday", 1, SCANS[1], params={"timestamp_s": 7.5})
    first, second = records(empty)
    assert (first.pose, first.timestamp_s) == (own, 5.0)
    assert (second.pose, second.timestamp_s) == (Pose(2.0, 2.0, 2.0), 7.5)


def test_a_drive_that_has_only_poses_is_empty_and_a_build_reports_that(empty):
    answer = put(empty, KITTI_LINES, KITTI).json()
    assert (answer["scans"], answer["present"]) == (0, [])
    assert empty.get(f"{DRIVE}/scans").json()["present"] == []
    assert empty.delete(DRIVE).status_code == 204


def test_a_closed_drive_expects_nothing(empty):
    upload_scan(empty, "campus", "monday", 0, SCANS[0])
    empty.patch(DRIVE, json={"closed": True})
    assert put(empty, "1 1 1 1 0 0 0 1\n", TUM).status_code == 200
    assert problem_of(put(empty, KITTI_LINES, KITTI)) == (404, "scan-not-found")
    assert records(empty)[0].pose == Pose(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("body", "kind", "problem"),
    [
        ("", KITTI, (422, "invalid-pose")),
        ("# nothing\n", TUM, (422, "invalid-pose")),
        ("1 2 3\n", KITTI, (422, "invalid-pose")),
        (f"{KITTI_LINES}2 0 0 4 0 1 0 5 0 0 1 6\n", KITTI, (422, "invalid-pose")),
        ("1 1 1 1 0 0 0 1\n1 1 1 1 0 0 0 2\n", TUM, (422, "invalid-pose")),
        ("1 1 1 1 0 0 0 one\n", TUM, (422, "invalid-pose")),
        ("1 2 3\n", CSV, (422, "invalid-pose")),
        ("scan,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0\n", CSV, (422, "invalid-pose")),
        ("scan,x,y,z,qx,qy,qz,qw\n-1,1,2,3,0,0,0,1\n", CSV, (422, "invalid-pose")),
        ("scan,x,y,z,qx,qy,qz,qw\n" + "0,1,2,3,0,0,0,1\n" * 2, CSV, (422, "invalid-pose")),
        ("scan,x,y,z,qx,qy,qz,qw\n9" + "9" * 15 + ",1,2,3,0,0,0,1\n", CSV, (422, "invalid-pose")),
        ("1 1 1 1 0 0 0 1\n", "text/plain", (415, "unsupported-body")),
        ("{", "application/json", (422, "invalid-request")),
    ],
)
def test_a_file_that_is_wrong_in_one_line_changes_nothing(empty, body, kind, problem):
    upload_scan(empty, "campus", "monday", 0, SCANS[0])
    before = whole_store(empty), records(empty)
    assert problem_of(put(empty, body, kind)) == problem
    assert (whole_store(empty), records(empty)) == before


def test_tums_lines_sent_as_kittis_are_rejected_with_their_own_media_type(empty):
    refused = put(empty, "0.5 1 1 1 0 0 0 1\n", KITTI)
    assert problem_of(refused) == (422, "invalid-pose")
    assert f"TUM's are {TUM}" in refused.json()["detail"]
    assert TUM not in put(empty, "1 1 1 0 0 0 1\n", KITTI).json()["detail"]


def lines(count, first_m=0.0):
    return "".join(f"1 0 0 {first_m + i} 0 1 0 0 0 0 1 0\n" for i in range(count))


@pytest.fixture
def posed(empty):
    """A drive of three scans with good poses."""
    for index in range(3):
        upload_scan(empty, "campus", "monday", index, SCANS[index])
    put(empty, lines(3), KITTI)
    return empty


def test_an_upload_of_poses_answers_how_many_were_set_and_how_many_wait(empty):
    upload_scan(empty, "campus", "monday", 0, SCANS[0])
    refused = put(empty, lines(3), KITTI)  # of another drive? 501 lines for 60 scans are too
    assert problem_of(refused) == (409, "poses-do-not-fit")
    assert "3 lines, of scans 0 to 2, drive 'monday' has scans up to 0" in refused.json()["detail"]
    assert empty.get(DRIVE).json()["poses_waiting"] == 0
    answer = put(empty, lines(3), KITTI, partial=True).json()
    counts = {"set": 1, "replaced": 0, "forgotten": 0, "waiting": 2, "left_over": 0}
    assert answer["poses"] == counts
    assert (answer["scans_with_pose"], answer["poses_waiting"], answer["poses_left_over"]) == (
        1,
        2,
        0,
    )
    upload_scan(empty, "campus", "monday", 1, SCANS[1])
    drive = empty.get(DRIVE).json()
    assert (drive["scans_with_pose"], drive["poses_waiting"]) == (2, 1)
    drive = empty.patch(DRIVE, json={"closed": True}).json()
    assert (drive["scans_with_pose"], drive["poses_waiting"], drive["poses_left_over"]) == (2, 0, 1)


@pytest.mark.parametrize("count", [2, 9])
def test_poses_of_another_drive_do_not_replace_good_ones(posed, count):
    before = records(posed)
    refused = put(posed, lines(count, first_m=50.0), KITTI)
    assert problem_of(refused) == (409, "poses-do-not-fit")
    assert f"{count} lines" in refused.json()["detail"]
    assert "partial=true" in refused.json()["detail"]
    assert records(posed) == before
    answer = put(posed, lines(count, first_m=50.0), KITTI, partial=True).json()["poses"]
    assert answer["set"] == answer["replaced"] == min(count, 3)
    assert answer["waiting"] == max(0, count - 3)


def test_too_few_poses_are_refused_also_where_there_were_none(empty):
    for index in range(3):
        upload_scan(empty, "campus", "monday", index, SCANS[index])
    assert problem_of(put(empty, lines(2), KITTI)) == (409, "poses-do-not-fit")
    assert empty.get(DRIVE).json()["scans_with_pose"] == 0
    assert put(empty, lines(2), KITTI, partial=True).json()["scans_with_pose"] == 2
    assert put(empty, lines(1, 2.0), KITTI, first=2).json()["scans_with_pose"] == 3


@pytest.mark.parametrize("last", [1, 7])
def test_a_table_that_ends_before_or_behind_the_last_scan_is_refused(empty, last):
    for index in range(3):
        upload_scan(empty, "campus", "monday", index, SCANS[index])
    table = f"scan,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n{last},1,0,0,0,0,0,1\n"
    refused = put(empty, table, CSV)
    assert problem_of(refused) == (409, "poses-do-not-fit")
    assert f"of scans 0 to {last}, drive 'monday' has scans up to 2" in refused.json()["detail"]
    assert put(empty, table, CSV, partial=True).status_code == 200


def test_poses_of_a_drive_whose_last_scan_was_left_out_are_set_as_their_error_advises(empty):
    for at in range(3):
        upload_scan(empty, "campus", "monday", 2 * at, SCANS[at])
    refused = put(empty, lines(6), KITTI)
    assert problem_of(refused) == (409, "poses-do-not-fit")
    advice = "if its last ones were left out, partial=true sets the others"
    assert refused.json()["detail"].endswith(advice)
    answer = put(empty, lines(6), KITTI, partial=True).json()["poses"]
    assert (answer["set"], answer["waiting"]) == (3, 3)


def test_a_file_does_not_take_poses_away(posed):
    body = f"{lines(1)}{'nan ' * 12}\n{lines(1, 2.0)}"
    refused = put(posed, body, KITTI)
    assert problem_of(refused) == (409, "poses-do-not-fit")
    assert "scan 1" in refused.json()["detail"]
    assert put(posed, body, KITTI, partial=True).json()["poses"]["forgotten"] == 1


def test_the_same_poses_and_better_ones_of_all_scans_are_set(posed):
    assert put(posed, lines(3), KITTI).json()["poses"]["replaced"] == 0
    assert put(posed, lines(5), KITTI).json()["poses"]["waiting"] == 2
    assert put(posed, lines(3, first_m=0.5), KITTI).json()["poses"]["replaced"] == 3


def test_poses_of_scans_that_a_closed_drive_lacks_are_left_over(posed):
    posed.patch(DRIVE, json={"closed": True})
    assert problem_of(put(posed, lines(9), KITTI)) == (404, "scan-not-found")
    answer = put(posed, lines(9), KITTI, partial=True).json()
    assert (answer["poses"]["set"], answer["poses"]["left_over"]) == (3, 6)
    assert answer["poses_left_over"] == 0


@pytest.mark.parametrize("partial", [False, True])
def test_poses_of_scans_that_can_never_be_stored_do_not_wait_for_them(empty, partial):
    head = "scan,x,y,z,qx,qy,qz,qw\n"
    before = whole_store(empty)
    refused = put(empty, f"{head}1679000000123,1,2,3,0,0,0,1\n", CSV, partial=partial)
    assert problem_of(refused) == (409, "poses-do-not-fit")
    assert "1679000000123, wanted less than 1000000000: is it a time?" in refused.json()["detail"]
    assert whole_store(empty) == before
    unknown = put(empty, f"{head}1679000000123,,,,,,,\n999999999,1,2,3,0,0,0,1\n", CSV)
    assert unknown.json()["poses"]["waiting"] == 1


@pytest.mark.parametrize("closed", [False, True])
def test_poses_that_wait_are_removed_by_lines_that_are_unknown(posed, closed):
    assert put(posed, lines(5), KITTI).json()["poses"]["waiting"] == 2
    if closed:
        assert posed.patch(DRIVE, json={"closed": True}).json()["poses_left_over"] == 2
    answer = put(posed, f"{'nan ' * 12}\n" * 2, KITTI, first=3, partial=closed).json()
    assert (answer["poses_waiting"], answer["poses_left_over"]) == (0, 0)
    assert answer["scans_with_pose"] == 3


def test_poses_that_no_vehicle_follows_are_reported_with_the_poses_and_by_a_build(empty):
    for index, scan in enumerate(recording().scans[:6]):
        upload_scan(empty, "campus", "monday", index, scan)
    answer = put(empty, lines(4) + lines(2, first_m=900.0), KITTI).json()
    assert (answer["poses"]["set"], answer["jumps"]) == (6, [4])
    back = {"poses": [{"scan": 2, "pose": [2, 0, 0, 0, 0, 0, 1]}]}
    assert empty.put(f"{DRIVE}/poses", json=back).json()["jumps"] == [4]
    listed = empty.get(f"{DRIVE}/poses").json()
    assert (listed["scans_with_pose"], listed["jumps"]) == (6, [4])
    assert empty.get(f"{DRIVE}/poses?first=4&limit=1").json()["jumps"] == []
    job = empty.post("/v1/maps/campus/builds", json={"encoding": "paper"}).json()["job"]
    [note] = [one for one in wait_for(empty, job)["notes"] if "jump" in one]
    assert "drive monday jump farther than a vehicle moves at 1 of 6 scans, first at scan 4" in note


def test_poses_as_json_are_counted_too(posed):
    own = {"scan": 1, "pose": [9, 9, 9, 0, 0, 0, 1]}
    answer = posed.put(f"{DRIVE}/poses", json={"poses": [own, {"scan": 2, "pose": None}]}).json()
    counts = {"set": 1, "replaced": 1, "forgotten": 1, "waiting": 0, "left_over": 0}
    assert answer["poses"] == counts
    assert answer["scans_with_pose"] == 2


def test_times_that_fall_are_refused(posed):
    body = "1 0 0 0 0 0 0 1\n3 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n"
    refused = put(posed, body, TUM)
    assert problem_of(refused) == (422, "invalid-pose")
    assert "scan 2 is of 2.000 s, before scan 1 of 3.000 s" in refused.json()["detail"]


def test_a_list_whose_times_fall_is_refused_whatever_its_order(posed):
    before = records(posed)
    items = [{"scan": 2, "timestamp_s": 40}, {"scan": 0, "timestamp_s": 50}, {"scan": 1}]
    refused = posed.put(f"{DRIVE}/poses", json={"poses": items})
    assert problem_of(refused) == (422, "invalid-pose")
    assert "scan 2 is of 40.000 s, before scan 0 of 50.000 s" in refused.json()["detail"]
    assert records(posed) == before
    items[0]["timestamp_s"] = 60
    assert posed.put(f"{DRIVE}/poses", json={"poses": items}).status_code == 200


def test_a_build_notes_a_drive_whose_times_fall_and_the_first_such_scan(empty):
    for index, time_s in enumerate((0.0, 0.1, 0.2, 0.15, None, 0.4)):
        given = {} if time_s is None else {"params": {"timestamp_s": time_s}}
        assert upload_scan(empty, "campus", "monday", index, SCANS[index % 4], **given).is_success
    job = empty.post("/v1/maps/campus/builds", json={"encoding": "paper"}).json()["job"]
    [note] = [one for one in wait_for(empty, job)["notes"] if "times" in one]
    assert "times of drive monday decrease at 1 of 6 scans, first at scan 3" in note


def test_poses_for_a_map_that_is_not_there_are_refused(empty):
    refused = empty.put(
        "/v1/maps/none/drives/monday/poses",
        content="1 1 1 1 0 0 0 1\n",
        headers={"Content-Type": TUM},
    )
    assert problem_of(refused) == (404, "map-not-found")


def test_poses_and_times_are_read_back_and_can_be_put_back(posed):
    upload_scan(posed, "campus", "monday", 7, SCANS[3], params={"timestamp_s": 0.7})
    put(posed, "scan,x,y,z,qx,qy,qz,qw\n9,1,2,3,0,0,0,1\n", CSV, partial=True)
    found = posed.get(f"{DRIVE}/poses").json()
    counts = {name: found[name] for name in ("scans", "scans_with_pose", "poses_waiting")}
    assert counts == {"scans": 4, "scans_with_pose": 3, "poses_waiting": 1}
    assert [item["scan"] for item in found["poses"]] == [0, 1, 2, 7]
    assert found["poses"][2] == {"scan": 2, "pose": [2, 0, 0, 0, 0, 0, 1], "timestamp_s": None}
    assert found["poses"][3] == {"scan": 7, "pose": None, "timestamp_s": 0.7}
    before = records(posed)
    put(posed, "1 0 0 0 0 0 0 1\n" * 3, TUM, partial="true")
    answer = posed.put(f"{DRIVE}/poses", json={"poses": found["poses"]})
    assert answer.json()["poses"]["set"] == 3
    assert [record.pose for record in records(posed)] == [record.pose for record in before]


def test_poses_are_read_in_parts(posed):
    found = posed.get(f"{DRIVE}/poses", params={"limit": 2}).json()
    assert ([item["scan"] for item in found["poses"]], found["next_first"]) == ([0, 1], 2)
    found = posed.get(f"{DRIVE}/poses", params={"limit": 2, "first": 2}).json()
    assert ([item["scan"] for item in found["poses"]], found["next_first"]) == ([2], None)
    assert problem_of(posed.get(f"{DRIVE}x/poses")) == (404, "drive-not-found")


def test_lists_count_the_scans_with_a_pose(posed):
    upload_scan(posed, "campus", "monday", 7, SCANS[3])
    [drive] = posed.get("/v1/maps/campus/drives").json()["items"]
    assert (drive["scans"], drive["scans_with_pose"]) == (4, 3)
    assert posed.get(f"{DRIVE}/scans").json()["scans_with_pose"] == 3
