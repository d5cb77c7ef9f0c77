"""Returns of mapped scans: kept, or dropped when no build needs them."""

import pytest

from app.drives.stored_images import images_path
from storage.files.checker import Checker
from storage.store.compaction import compact
from tests.support.campus import MAP, acts, build, keep, localize
from tests.support.process import until
from tests.support.recording import KITTI, Recording, far_away, kitti, recording
from tests.support.service import damage, problem_of, upload

DRIVE = f"{MAP}/drives/monday"
TUESDAY = f"{MAP}/drives/tuesday"
PLAIN = {"lateral_renderings_m": [0], "views": "full"}


def chunk_bytes(client, drive):
    store = client.service.store
    found = store.drives.get("campus", drive)
    folder = store.layout.chunks(found.map_id, found.id)
    return sum(path.stat().st_size for path in folder.iterdir())


def test_returns_of_the_live_revision_are_dropped_and_shown_as_dropped(mapped):
    before = chunk_bytes(mapped, "monday")
    of_tuesday = chunk_bytes(mapped, "tuesday")
    keep(mapped, raw_scans="drop")
    drive = mapped.get(DRIVE).json()
    assert (drive["scans"], drive["scans_without_returns"]) == (17, 16)
    assert drive["size_bytes"] == 200 * 12  # of the one that the map does not have
    assert mapped.get(f"{DRIVE}/scans").json()["scans_without_returns"] == 16
    assert chunk_bytes(mapped, "monday") < before / 10
    assert chunk_bytes(mapped, "tuesday") == of_tuesday
    assert problem_of(mapped.get(f"{DRIVE}/scans/3")) == (409, "returns-gone")
    assert mapped.get(f"{DRIVE}/scans/16").status_code == 200
    assert mapped.get(f"{MAP}/drives/tuesday/scans/3").status_code == 200
    ((who, _, detail),) = (act for act in acts(mapped) if act[1] == "drop_returns")
    assert who == "service"
    assert "monday: returns of 16 scans" in detail
    mapped.service.collector.collect()
    mapped.patch(DRIVE, json={"closed": True})  # packs again
    assert mapped.get(DRIVE).json() == drive
    assert localize(mapped, "scan", content=kitti(recording().scans[4]), headers=KITTI)["localized"]


def test_a_scan_that_is_sent_again_is_known_by_its_digest(mapped):
    keep(mapped, raw_scans="drop")
    again = mapped.put(f"{DRIVE}/scans/3", content=kitti(recording().scans[3]), headers=KITTI)
    assert (again.status_code, again.json()["returns_kept"]) == (200, False)
    other = mapped.put(f"{DRIVE}/scans/3", content=kitti(recording().scans[4]), headers=KITTI)
    assert problem_of(other) == (409, "scan-conflict")
    assert problem_of(mapped.get(f"{DRIVE}/scans/3")) == (409, "returns-gone")


def test_builds_on_the_images_continue_and_others_are_refused_by_name(mapped):
    keep(mapped, raw_scans="drop")
    added = build(mapped, base="live", add=["tuesday"], make_live=True)
    shown = mapped.get(f"{MAP}/revisions/{added['revision']}").json()
    assert (shown["parameters"]["drives"], shown["scans"]) == (["monday", "tuesday"], 24)
    build(mapped, ranks=[4, 4], segment_length=4, **PLAIN)  # other bases of the same images
    for body in (
        {"encoding": "paper"},
        {},
        {"reducer": "mean", **PLAIN},
        {"sensor_height_m": 1.5, **PLAIN},
    ):
        refused = mapped.post(f"{MAP}/builds", json=body)
        assert problem_of(refused) == (409, "returns-gone")
        assert "16 of 17 scans" in refused.json()["detail"]
    without = build(mapped, drives=["tuesday"], encoding="paper")
    assert without["state"] == "done"


def test_an_open_drive_keeps_its_returns_until_it_is_closed_and_built(mapped):
    keep(mapped, raw_scans="drop")
    build(mapped, base="live", add=["tuesday"], make_live=True)
    mapped.service.collector.collect()
    tuesday = f"{MAP}/drives/tuesday"
    assert mapped.get(tuesday).json()["scans_without_returns"] == 0
    mapped.put(f"{tuesday}/scans/8", content=kitti(recording().scans[24]), headers=KITTI)
    mapped.patch(tuesday, json={"closed": True})
    mapped.service.collector.collect()
    # The live revision lacks its last scan, so images of the whole drive are still to be made.
    assert mapped.get(tuesday).json()["scans_without_returns"] == 0
    build(mapped, base="live", add=["tuesday"], make_live=True)
    mapped.service.collector.collect()
    assert mapped.get(tuesday).json()["scans_without_returns"] == 9


def test_closing_a_drive_that_is_mapped_drops_its_returns_by_itself(mapped):
    build(mapped, drives=["tuesday"], make_live=True, **PLAIN)
    keep(mapped, raw_scans="drop")
    tuesday = f"{MAP}/drives/tuesday"
    assert mapped.get(tuesday).json()["scans_without_returns"] == 0
    mapped.patch(tuesday, json={"closed": True})
    until(
        lambda: mapped.get(tuesday).json()["scans_without_returns"] == 8,
        "the returns are not dropped",
    )


def test_a_drive_whose_returns_are_dropped_while_it_is_packed_is_closed(mapped, monkeypatch):
    tuesday = f"{MAP}/drives/tuesday"
    mapped.put(f"{tuesday}/scans/8", content=kitti(recording().scans[24]), headers=KITTI)
    build(mapped, drives=["tuesday"], make_live=True, **PLAIN)
    keep(mapped, raw_scans="drop")

    def compact_late(catalog, drive_id, chunks, read):
        def read_late(index):
            mapped.service.collector.collect()
            return read(index)

        compact(catalog, drive_id, chunks, read_late)

    monkeypatch.setattr("storage.store.drives.compact", compact_late)
    closed = mapped.patch(tuesday, json={"closed": True})
    assert (closed.status_code, closed.json().get("closed")) == (200, True)
    assert mapped.get(tuesday).json()["scans_without_returns"] == 9


def test_a_drive_that_is_deleted_while_returns_are_dropped_is_no_error(mapped, monkeypatch, caplog):
    def path_late(*target):
        mapped.delete(DRIVE)
        return images_path(*target)

    monkeypatch.setattr("app.collector.images_path", path_late)
    with caplog.at_level("INFO", "tensormap.collector"):
        keep(mapped, raw_scans="drop")
        until(lambda: "was deleted" in caplog.text, "the deletion is not logged")
    assert {record.levelname for record in caplog.records} == {"INFO"}


def test_what_only_another_revision_has_keeps_its_returns(mapped):
    mapped.patch(f"{MAP}/drives/tuesday", json={"closed": True})
    build(mapped, drives=["tuesday"], **PLAIN)
    keep(mapped, raw_scans="drop")
    assert mapped.get(DRIVE).json()["scans_without_returns"] == 16
    assert mapped.get(f"{MAP}/drives/tuesday").json()["scans_without_returns"] == 0


def test_a_drive_made_anew_under_the_name_of_a_mapped_one_keeps_its_returns(mapped):
    mapped.delete(DRIVE)
    upload(mapped, "monday", Recording(recording(noise_seed=3).scans[:16]))
    mapped.patch(DRIVE, json={"closed": True})
    keep(mapped, raw_scans="drop")
    assert mapped.get(DRIVE).json()["scans_without_returns"] == 0


def test_an_imported_revision_drops_no_returns(mapped):
    shown = mapped.get(MAP).json()["live_revision"]
    body = mapped.get(f"{MAP}/revisions/{shown}/file").content
    mapped.post("/v1/maps", json={"map": "copy"})
    for index in range(16):
        mapped.put(
            f"/v1/maps/copy/drives/monday/scans/{index}",
            content=kitti(recording(noise_seed=3).scans[index]),
            headers=KITTI,
        )
    mapped.patch("/v1/maps/copy/drives/monday", json={"closed": True})
    mapped.post(
        "/v1/maps/copy/revisions",
        content=body,
        headers={"Content-Type": "application/vnd.tensormap.map+hdf5"},
    )
    mapped.patch("/v1/maps/copy", json={"retention": {"raw_scans": "drop"}})
    mapped.service.collector.collect()
    assert mapped.get("/v1/maps/copy/drives/monday").json()["scans_without_returns"] == 0


def test_a_drive_whose_scans_are_damaged_keeps_no_other_from_dropping_its_returns(mapped, caplog):
    mapped.patch(TUESDAY, json={"closed": True})
    build(mapped, drives=["monday", "tuesday"], segment_length=8, make_live=True, **PLAIN)
    store = mapped.service.store
    drive = store.drives.get("campus", "monday")
    (record,) = store.catalog.scans.of_drive(drive.id)[16:]  # of no use to maps: it stays
    path = store.layout.chunks(drive.map_id, drive.id) / record.chunk
    content = bytearray(path.read_bytes())
    content[content.rindex(far_away().astype("<f4")[-9:].tobytes())] ^= 1
    damage(path, content)
    keep(mapped, raw_scans="drop")
    kept = [mapped.get(one).json()["scans_without_returns"] for one in (DRIVE, TUESDAY)]
    assert kept == [0, 8]
    [failure] = {one.getMessage() for one in caplog.records if one.levelname == "ERROR"}
    assert failure.startswith("returns of drive monday of map campus cannot be dropped: scan 16 of")


POSES = {"Content-Type": "application/vnd.tensormap.poses.kitti"}


def remount(client):
    mounting = {"x_m": 1.2, "y_m": 0.0, "z_m": 1.9}
    return client.put(TUESDAY, json={"mounting": mounting, "accumulate": 2})


def put_other_poses(client):
    return client.put(f"{TUESDAY}/poses", content=b"1 0 0 7 0 1 0 0 0 0 1 0\n" * 8, headers=POSES)


def make_anew(client):
    client.delete(TUESDAY)
    upload(client, "tuesday", Recording(recording(noise_seed=3).scans[:8]))
    return client.patch(TUESDAY, json={"closed": True})


@pytest.mark.parametrize("change", [remount, put_other_poses, make_anew])
def test_returns_stay_if_their_drive_is_changed_while_its_images_are_read(
    mapped, monkeypatch, change
):
    mapped.put(TUESDAY, json={"accumulate": 2})
    build(mapped, drives=["tuesday"], segment_length=4, make_live=True, **PLAIN)
    mapped.patch(TUESDAY, json={"closed": True})
    read_whole = Checker.fault
    changed: list[int] = []

    def read_while_changed(checker, *file):
        if not changed:
            changed.append(change(mapped).status_code)
        return read_whole(checker, *file)

    monkeypatch.setattr(Checker, "fault", read_while_changed)
    keep(mapped, raw_scans="drop")
    assert changed == [200]
    assert mapped.get(TUESDAY).json()["scans_without_returns"] == 0
    assert mapped.get(f"{TUESDAY}/scans/3").status_code == 200


def test_returns_stay_if_a_build_on_another_height_removes_the_images_that_are_read(
    mapped, monkeypatch
):
    mapped.put(TUESDAY, json={"mounting": {"x_m": 1.2, "y_m": 0.0, "z_m": 1.9}})
    build(mapped, drives=["tuesday"], encoding="paper", make_live=True)
    mapped.patch(TUESDAY, json={"closed": True})
    read_whole = Checker.fault

    def read_and_built(checker, *file):
        fault = read_whole(checker, *file)
        build(mapped, drives=["tuesday"], encoding="paper", sensor_height_m=1.5)
        return fault

    monkeypatch.setattr(Checker, "fault", read_and_built)
    keep(mapped, raw_scans="drop")
    assert mapped.get(TUESDAY).json()["scans_without_returns"] == 0
