"""Mountings of sensors and accumulated scans over HTTP."""

from dataclasses import replace

import pytest

from app.drives.mapped_drives import mapped_digest
from core import MapParameters, build_map
from core.loop_closure.closure import check_scans
from core.scans.accumulation import accumulated_scan
from core.scans.mounting import Mounting, vehicle_drive
from core.scans.pose import Pose
from storage.files import image_file
from tests.support.campus import MAP, build, keep
from tests.support.mounted import ASKEW, mounted_recording
from tests.support.odometry import needs_odometry
from tests.support.recording import TAR, Recording, kitti, recording, tar
from tests.support.service import problem_of, upload, wait_for

DRIVES = f"{MAP}/drives"
TEXT = "1.1,-0.4,1.9,3,-6,120"
PLAIN = {"segments": 1, "views": "full", "lateral_renderings_m": [0.0]}
"""Of what is built fastest, where a test does not depend on views or renderings."""
SENT = {"x_m": 1.1, "y_m": -0.4, "z_m": 1.9, "roll_deg": 3.0, "pitch_deg": -6.0, "yaw_deg": 120.0}


def recorded(**options):
    return Recording(tuple(mounted_recording(**options)))


class TestDrives:
    def test_a_drive_is_made_with_its_mounting_and_shows_it(self, empty):
        made = empty.put(f"{DRIVES}/monday", json={"mounting": SENT, "accumulate": 4})
        assert (made.status_code, made.headers["Location"]) == (201, f"{DRIVES}/monday")
        assert (made.json()["mounting"], made.json()["accumulate"]) == (SENT, 4)
        assert empty.get(f"{DRIVES}/monday").json() == made.json()
        assert empty.get(DRIVES).json()["items"] == [made.json()]
        upload(empty, "monday", recording(scans=3))
        assert empty.get(f"{DRIVES}/monday").json()["scans"] == 3

    def test_a_shared_basis_is_fitted_to_the_sums_of_accumulated_scans(self, empty, monkeypatch):
        scans = recording().scans
        for slug, step_m in (("a", 1.0), ("b", 0.06)):  # scans of b are a stand each few
            poses = [Pose(step_m * i, 0.0, 1.73, 0.0, 0.0, 0.0, 1.0) for i in range(len(scans))]
            moved = [replace(s, pose=pose) for s, pose in zip(scans, poses, strict=True)]
            assert empty.post("/v1/maps", json={"map": slug}).status_code == 201
            upload(empty, "monday", Recording(tuple(moved)), slug=slug)
            empty.put(f"/v1/maps/{slug}/drives/monday", json={"accumulate": 4})
            options = {**PLAIN, "poses": "unchecked", "force": True, "make_live": True}
            started = empty.post(f"/v1/maps/{slug}/builds", json=options)
            assert wait_for(empty, started.json()["job"])["state"] == "done"
        monkeypatch.setattr(image_file, "drive_gram", None)  # no image is read again
        made = empty.post("/v1/bases", json={"name": "city", "maps": ["a", "b"]})
        assert made.status_code == 201, made.text

    def test_a_mounting_is_replaced_and_removed(self, empty):
        upload(empty, "monday", recording(scans=3))
        drive = empty.get(f"{DRIVES}/monday").json()
        assert (drive["mounting"], drive["accumulate"]) == (None, 1)
        put = empty.put(f"{DRIVES}/monday", json={"mounting": {"x_m": 1, "y_m": 0, "z_m": 2}})
        assert put.status_code == 200
        assert put.json()["mounting"] == {**dict.fromkeys(SENT, 0.0), "x_m": 1.0, "z_m": 2.0}
        assert empty.put(f"{DRIVES}/monday", json={}).json() == drive

    @pytest.mark.parametrize(
        "body",
        [
            {"mounting": {**SENT, "z_m": 0}},
            {"mounting": {**SENT, "x_m": 51}},
            {"mounting": {**SENT, "yaw_deg": 361}},
            {"mounting": {"z_m": 1.7}},
            {"mounting": TEXT},
            {"accumulate": 0},
            {"accumulate": 65},
            {"accumulate": True},
            {"pose": [0, 0, 0]},
        ],
    )
    def test_what_is_no_mounting_is_rejected_and_makes_no_drive(self, empty, body):
        answer = empty.put(f"{DRIVES}/monday", json=body)
        assert problem_of(answer) == (422, "invalid-request")
        assert empty.get(DRIVES).json()["items"] == []

    def test_a_map_or_name_that_cannot_be_is_rejected(self, empty):
        assert problem_of(empty.put("/v1/maps/no/drives/a", json={})) == (404, "map-not-found")
        assert problem_of(empty.put(f"{DRIVES}/A", json={})) == (422, "invalid-slug")

    def test_a_build_notes_a_pitch_that_the_sensor_does_not_have_until_it_is_corrected(self, empty):
        upload(empty, "monday", recording(scans=12))
        right = {**dict.fromkeys(SENT, 0.0), "z_m": 1.73}
        found = []
        for mounting in ({**right, "pitch_deg": 25.0}, right):
            empty.put(f"{DRIVES}/monday", json={"mounting": mounting}).raise_for_status()
            notes = build(empty, **PLAIN)["notes"]
            found.append([note for note in notes if "the ground is tilted" in note])
        assert [len(notes) for notes in found] == [1, 0]

    @needs_odometry
    def test_a_build_notes_a_sensor_that_is_upside_down_until_its_mounting_is_set(self, empty):
        mounting = {**dict.fromkeys(SENT, 0.0), "z_m": 1.73, "roll_deg": 180.0}
        scans = mounted_recording(Mounting(**mounting), scans=12, name="hanging")
        upload(empty, "monday", Recording(tuple(scans)))

        def of_axes():
            return [note for note in build(empty, **PLAIN)["notes"] if "points up" in note]

        [note] = of_axes()
        assert "monday: the ground is not below the sensor, -z points up in 10 of 10 scans" in note
        assert "turn the drive's mounting by roll_deg 180 and build again" in note
        empty.put(f"{DRIVES}/monday", json={"mounting": mounting})
        assert of_axes() == []
        files = tar([(f"{index:06}.bin", kitti(scan)) for index, scan in enumerate(scans)])
        sent = empty.post(
            f"{DRIVES}/tuesday/scans", content=files, headers=TAR, params={"format": "kitti"}
        )
        assert sent.status_code == 200
        [note] = of_axes()
        assert "tuesday" in note
        assert "turn the scans and upload them as another drive" in note

    def test_once_returns_are_dropped_it_can_no_longer_change(self, empty):
        upload(empty, "monday", recording(scans=12))
        empty.put(f"{DRIVES}/monday", json={"mounting": SENT, "accumulate": 2})
        built = build(empty, **PLAIN)
        empty.patch(f"{DRIVES}/monday", json={"closed": True})
        keep(empty, raw_scans="drop")
        drive = empty.get(f"{DRIVES}/monday").json()
        assert drive["scans_without_returns"] == 12  # also those that are not the last of two
        answer = empty.put(f"{DRIVES}/monday", json={"accumulate": 2})
        assert problem_of(answer) == (409, "returns-gone")
        assert "12 of 12 scans" in answer.json()["detail"]
        same = empty.put(f"{DRIVES}/monday", json={"mounting": SENT, "accumulate": 2})
        assert same.json() == drive
        assert build(empty, **PLAIN)["revision"] == built["revision"]  # of the kept images

    def test_once_returns_are_dropped_poses_by_which_scans_become_one_can_no_longer_change(
        self, empty
    ):
        upload(empty, "monday", recording(scans=12))
        empty.put(f"{DRIVES}/monday", json={"accumulate": 2})
        build(empty, **PLAIN)
        empty.patch(f"{DRIVES}/monday", json={"closed": True})
        keep(empty, raw_scans="drop")
        stored = {"poses": empty.get(f"{DRIVES}/monday/poses").json()["poses"]}
        assert empty.put(f"{DRIVES}/monday/poses", json=stored).status_code == 200  # they are same
        x, *rest = stored["poses"][3]["pose"]
        for pose in ([x + 0.001, *rest], None):
            changed = {"poses": [{"scan": 3, "pose": pose}]}
            answer = empty.put(f"{DRIVES}/monday/poses", json=changed)
            assert problem_of(answer) == (409, "returns-gone")
            assert "the returns of 12 of 12 scans" in answer.json()["detail"]
        as_file = "".join(f"{at},{at},0,0,0,0,0,1\n" for at in range(12))
        answer = empty.put(
            f"{DRIVES}/monday/poses",
            content="scan,x,y,z,qx,qy,qz,qw\n" + as_file,
            headers={"Content-Type": "application/vnd.tensormap.poses.csv"},
        )
        assert problem_of(answer) == (409, "returns-gone")
        timed = {"poses": [{"scan": 3, "timestamp_s": 3.0}]}
        assert empty.put(f"{DRIVES}/monday/poses", json=timed).status_code == 200
        assert build(empty, **PLAIN)["state"] == "done"  # of the kept images


class TestBuilds:
    def test_a_mounting_makes_other_images_and_the_same_one_the_same(self, empty):
        upload(empty, "askew", Recording(recorded().scans[:20]))
        found = []
        setups: list[dict[str, object]] = [{}, {"mounting": SENT}, {"accumulate": 4}, {}]
        for setup in setups:
            empty.put(f"{DRIVES}/askew", json=setup)
            job = build(empty, **PLAIN, refit=True)
            facts = empty.get(f"{MAP}/revisions/{job['revision']}").json()
            named = {k: facts["parameters"].get(k) for k in ("mountings", "accumulate")}
            found.append((job["revision"], facts["scans"], named))
        revisions = [revision for revision, _, _ in found]
        assert len(set(revisions)) == 3
        assert revisions[0] == revisions[3]
        assert [scans for _, scans, _ in found] == [20, 20, 5, 20]
        assert [facts for _, _, facts in found][:3] == [
            {"mountings": None, "accumulate": None},
            {"mountings": {"askew": SENT}, "accumulate": None},
            {"mountings": None, "accumulate": {"askew": 4}},
        ]

    def test_service_and_core_build_one_map(self, empty):
        empty.put(f"{DRIVES}/askew", json={"mounting": SENT, "accumulate": 3})
        upload(empty, "askew", recorded(sparse=True))
        parameters = MapParameters.for_sensor()
        drive = vehicle_drive(mounted_recording(sparse=True), ASKEW, 1.73, 3)
        built = build(empty, segments=2)
        assert built["revision"] == build_map(drive, parameters, segments=2).revision

    def test_images_depend_on_all_that_they_are_made_of(self, empty):
        upload(empty, "monday", recording(scans=4))
        store = empty.service.store

        def digest(height_m=1.73, **setup):
            empty.put(f"{DRIVES}/monday", json=setup)
            return mapped_digest(store.drives.open("campus", "monday"), height_m)

        plain = digest()
        assert digest(2.0) == plain
        mounted = digest(mounting=SENT)
        others = {
            digest(2.0, mounting=SENT),
            digest(mounting={**SENT, "x_m": 1.1000000001}),
            digest(accumulate=2),
            digest(accumulate=3),
        }
        assert len({plain, mounted, *others}) == 6
        before = digest(accumulate=2)
        empty.put(f"{DRIVES}/monday/poses", json={"poses": [{"scan": 1, "pose": None}]})
        assert digest(accumulate=2) != before
        assert digest() == plain

    def test_scans_without_poses_do_not_become_one(self, empty):
        empty.put(f"{DRIVES}/monday", json={"accumulate": 2})
        files = [(f"{i:06}.bin", kitti(recording().scans[i])) for i in range(4)]
        empty.post(
            f"{DRIVES}/monday/scans", content=tar(files), headers=TAR, params={"format": "kitti"}
        )
        job = empty.post(f"{MAP}/builds", json={"odometry": False}).json()["job"]
        ended = empty.get(f"/v1/jobs/{job}").json()
        while ended["state"] in ("queued", "running"):
            ended = empty.get(f"/v1/jobs/{job}").json()
        assert ended["error"]["type"] == "/problems/empty-drive"
        assert "has no pose" in ended["error"]["detail"]


def test_accumulated_scans_are_compared_with_those_before_them(empty):
    upload(empty, "askew", recorded(scans=14, sparse=True))
    empty.put(f"{DRIVES}/askew", json={"mounting": SENT, "accumulate": 6})
    drive = mounted_recording(scans=14, sparse=True)
    first, second = (ASKEW.mount(accumulated_scan(drive, i, 6), 1.73) for i in (10, 11))
    expected = check_scans(first, second, 1.73)

    def check(index):
        stored = [{"drive": "askew", "scan_index": i} for i in (10, index)]
        body = {"proposals": [{"first": stored[0], "second": stored[1]}], "sensor_height_m": 1.73}
        return empty.post(f"{MAP}/loop-closures", json=body)

    [found] = check(11).json()["closures"]
    assert found["overlap"] == pytest.approx(expected.overlap)
    assert found["image_similarity"] == pytest.approx(expected.image_similarity)
    assert problem_of(check(14)) == (404, "scan-not-found")


def test_a_change_is_in_the_audit_log(empty):
    empty.put(f"{DRIVES}/monday", json={"mounting": SENT, "accumulate": 2})
    entry = empty.get("/v1/audit").json()["items"][-1]
    assert entry["action"] == "put_drive"
    assert entry["detail"] == f"mounting {Mounting.from_text(TEXT)}, accumulate 2"
