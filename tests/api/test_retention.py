"""What a map keeps: revisions by number and age, and the returns that it was built of."""

import shutil
import threading
from datetime import timedelta

import pytest

from storage.backup import write_backup
from storage.catalog.models import Revision
from storage.errors import StorageUnavailable
from storage.restore import restore_backup
from storage.retention import Retention
from storage.store import Store
from tests.api.test_flow import localize
from tests.api.test_merging import built as build
from tests.api.test_revisions import ask, signed
from tests.support.recording import KITTI, NPY, Recording, kitti, npy, recording
from tests.support.service import problem_of, running, upload, wait_for

MAP = "/v1/maps/campus"
DRIVE = f"{MAP}/drives/monday"
DEFAULT = {"retained_revisions": "all", "retained_for_days": 30.0, "raw_scans": "keep"}
PLAIN = {"lateral_renderings_m": [0]}
NOTHING = {"retained_revisions": 0, "retained_for_days": 0}


def keep(client, **retention):
    """Choose what is kept, and wait until what is not is gone."""
    changed = client.patch(MAP, json={"retention": retention})
    assert changed.status_code == 200, changed.text
    client.service.collector.collect()
    return changed.json()


def listed(client):
    return {item["revision"] for item in client.get(f"{MAP}/revisions").json()["items"]}


def files(client):
    store = client.service.store
    folder = store.layout.revisions(store.maps.get("campus").id)
    return {path.name.partition(".")[0] for path in folder.iterdir()}


def acts(client):
    page = client.service.store.audit.list(limit=1000)
    return [(entry.key_id, entry.action, entry.detail) for entry in page.items]


@pytest.fixture(scope="module")
def with_a_third(tmp_path_factory, built):
    """The data of a stopped service with three revisions, and the newest one's digest."""
    data_dir = tmp_path_factory.mktemp("three") / "data"
    shutil.copytree(built.data_dir, data_dir, ignore=shutil.ignore_patterns("*.lock"))
    with running(data_dir) as client:
        newest = build(client, segments=5, encoding="paper")["revision"]
    return data_dir, newest


@pytest.fixture
def three(tmp_path, built, with_a_third):
    """A service and its three revisions: the live one, another, and the newest."""
    data_dir, newest = with_a_third
    shutil.copytree(data_dir, tmp_path / "data", ignore=shutil.ignore_patterns("*.lock"))
    with running(tmp_path / "data") as client:
        yield client, built.live, built.other, newest


def test_a_map_keeps_everything_until_somebody_says_otherwise(three):
    client, *revisions = three
    shown = client.get(MAP).json()
    assert shown["retention"] == dict.fromkeys(DEFAULT)
    assert shown["retention_in_force"] == DEFAULT
    client.service.collector.collect()
    assert listed(client) == files(client) == set(revisions)


def test_a_policy_is_changed_in_parts_and_only_of_the_version_that_was_seen(own):
    seen = own.get(MAP).headers["ETag"]
    changed = own.patch(
        MAP, json={"retention": {"retained_revisions": 2}}, headers={"If-Match": seen}
    )
    assert changed.headers["ETag"] == own.get(MAP).headers["ETag"] != seen
    refused = own.patch(MAP, json={"retention": NOTHING}, headers={"If-Match": seen})
    assert problem_of(refused) == (412, "map-changed")
    told = keep(own, raw_scans="drop")
    assert told["retention"] == {
        "retained_revisions": 2,
        "retained_for_days": None,
        "raw_scans": "drop",
    }
    assert told["retention_in_force"] == {**DEFAULT, "retained_revisions": 2, "raw_scans": "drop"}
    assert told["description"] == own.get("/v1/maps").json()["items"][0]["description"]
    assert keep(own, retained_revisions=None, raw_scans=None)["retention_in_force"] == DEFAULT
    assert ("everyone", "update_map", "retention raw_scans=drop") in acts(own)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"retention": {"retained_revisions": -1}},
        {"retention": {"retained_revisions": "some"}},
        {"retention": {"retained_for_days": 40_000}},
        {"retention": {"raw_scans": "perhaps"}},
        {"retention": {"forever": True}},
        {"retention": None},
    ],
)
def test_a_policy_that_is_none_is_refused_and_nothing_changes(client, wrong):
    before = client.get(MAP).json()
    assert problem_of(client.patch(MAP, json=wrong)) == (422, "invalid-request")
    assert client.get(MAP).json() == before


def test_a_revision_that_is_not_retained_goes_and_its_signatures_are_stale(three):
    client, live, other, newest = three
    signature = signed(client, other)
    assert ask(client, signature).status_code == 200
    keep(client, **NOTHING)
    assert listed(client) == files(client) == {live, newest}
    refused = ask(client, signature)
    assert problem_of(refused) == (409, "stale-signature")
    assert live in refused.json()["detail"]
    assert problem_of(client.get(f"{MAP}/revisions/{other}")) == (404, "revision-not-found")
    assert ("service", "collect_revision", f"revision {other}") in acts(client)
    assert client.service.store.audit.verify().fault is None


def test_a_replaced_revision_stays_for_its_time_and_answers_signatures_of_it(three):
    client, live, other, newest = three
    signature = signed(client, live)
    keep(client, retained_revisions=0, retained_for_days=1)
    client.put(f"{MAP}/live", json={"revision": newest})
    client.service.collector.collect()
    assert listed(client) == {live, other, newest}
    found = ask(client, signature).json()
    assert (found["revision"], found["live_revision"]) == (live, newest)
    with client.service.store.catalog._database.writing() as session:
        row = session.get_one(Revision, (client.service.store.maps.get("campus").id, live))
        row.retained_from -= timedelta(days=2)
    client.service.collector.collect()
    assert listed(client) == {other, newest}
    assert problem_of(ask(client, signature)) == (409, "stale-signature")


def wait_until(condition):
    for _ in range(400):
        if condition():
            return
        threading.Event().wait(0.02)
    raise AssertionError("it did not come true")


def test_a_build_and_a_change_of_live_collect_by_themselves(own, built):
    own.patch(MAP, json={"retention": NOTHING})
    newest = build(own, segments=5, encoding="paper")["revision"]
    wait_until(lambda: listed(own) == files(own) == {built.live, newest})
    own.put(f"{MAP}/live", json={"revision": newest})
    wait_until(lambda: listed(own) == files(own) == {newest})


def test_a_start_collects_by_the_services_defaults_unless_a_map_chose_otherwise(
    tmp_path, built, with_a_third
):
    data_dir, newest = with_a_third
    for name in ("chose", "did-not"):
        shutil.copytree(data_dir, tmp_path / name, ignore=shutil.ignore_patterns("*.lock"))
    with Store(tmp_path / "chose") as store:
        store.maps.update("campus", retention={"retained_revisions": "all"})
    with running(tmp_path / "did-not", **NOTHING) as client:
        wait_until(lambda: listed(client) == files(client) == {built.live, newest})
        assert client.get(MAP).json()["retention_in_force"] == {**DEFAULT, **NOTHING}
    with running(tmp_path / "chose", **NOTHING) as client:
        client.service.collector.collect()
        assert listed(client) == {built.live, built.other, newest}


def test_what_a_crash_left_of_a_collected_revision_is_set_aside_at_the_next_start(three):
    client, _, other, _ = three
    store = client.service.store
    store.catalog.collector.collect(store.maps.get("campus").id, other, Retention(0, 0.0))
    assert other in files(client)
    client.__exit__(None, None, None)
    with running(client.service.settings.data_dir) as again:
        assert other not in files(again)
        assert list(again.service.store.layout.orphans.rglob(f"{other}*"))


def test_a_map_that_fails_keeps_no_other_from_being_collected(three, monkeypatch, caplog):
    client, live, _, newest = three
    client.post("/v1/maps", json={"map": "alpha"})
    failing = client.service.store.maps.get("alpha").id
    found = client.service.store.revisions.collectable

    def fail(map_id, policy):
        if map_id == failing:
            raise StorageUnavailable("just now")
        return found(map_id, policy)

    monkeypatch.setattr(client.service.store.revisions, "collectable", fail)
    keep(client, **NOTHING)
    assert listed(client) == {live, newest}
    assert "map alpha" in caplog.text


def test_no_query_fails_while_revisions_replace_each_other_and_are_not_retained(own, built):
    """The live one may go between being named and being read, and then the new one answers."""
    own.patch(MAP, json={"retention": NOTHING})
    body = own.get(f"{MAP}/revisions/{built.other}/file").content
    done = threading.Event()
    answers = []

    def localize_on():
        while not done.is_set():
            answers.append(
                own.post(
                    f"{MAP}/localizations/scan", content=kitti(recording().scans[3]), headers=KITTI
                )
            )

    threads = [threading.Thread(target=localize_on) for _ in range(3)]
    for thread in threads:
        thread.start()
    first = own.get(f"{MAP}/revisions/{built.live}/file").content
    try:
        for turn in range(12):
            imported = own.post(
                f"{MAP}/revisions",
                params={"make_live": True},
                content=(body, first)[turn % 2],
                headers={"Content-Type": "application/vnd.tensormap.map+hdf5"},
            )
            assert imported.status_code in {200, 201}
            own.service.collector.collect()
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert {answer.status_code for answer in answers} == {200}
    for answer in answers:
        assert answer.json()["revision"] in {built.live, built.other}


# Raw returns


@pytest.fixture(scope="module")
def mapped_once(tmp_path_factory):
    data_dir = tmp_path_factory.mktemp("mapped") / "data"
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", Recording(recording().scans[:16]))
        upload(client, "tuesday", Recording(recording().scans[16:24]))
        client.put(f"{DRIVE}/scans/16", content=npy(far_away()), headers=NPY)
        client.patch(DRIVE, json={"closed": True})
        build(client, drives=["monday"], segment_length=8, **PLAIN)
    return data_dir


@pytest.fixture
def mapped(tmp_path, mapped_once):
    """A map of one closed drive that has a scan which is of no use, and another drive beside it."""
    shutil.copytree(mapped_once, tmp_path / "data", ignore=shutil.ignore_patterns("*.lock"))
    with running(tmp_path / "data") as client:
        yield client


def far_away():
    """Return a scan that no map can use: every return is beyond the rings."""
    return recording().scans[0].points_m[:200] * 0.0 + [500.0, 0.0, 0.0]


def chunk_bytes(client, drive):
    store = client.service.store
    found = store.drives.get("campus", drive)
    folder = store.layout.chunks(found.map_id, found.id)
    return sum(path.stat().st_size for path in folder.iterdir())


def test_returns_that_the_live_revision_was_built_of_are_dropped_and_said_to_be(mapped):
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


def test_builds_on_the_images_go_on_and_others_are_refused_by_name(mapped):
    keep(mapped, raw_scans="drop")
    added = build(mapped, base="live", add=["tuesday"], make_live=True)
    shown = mapped.get(f"{MAP}/revisions/{added['revision']}").json()
    assert (shown["parameters"]["drives"], shown["scans"]) == (["monday", "tuesday"], 24)
    build(mapped, ranks=[4, 4], segment_length=4, **PLAIN)  # other bases of the same images
    for wanted in (
        {"encoding": "paper"},
        {},
        {"reducer": "mean", **PLAIN},
        {"sensor_height_m": 1.5, **PLAIN},
    ):
        refused = mapped.post(f"{MAP}/builds", json=wanted)
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
    wait_until(lambda: mapped.get(tuesday).json()["scans_without_returns"] == 8)


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


def images_of(client, drive):
    store = client.service.store
    found = store.drives.get("campus", drive)
    folder = store.layout.images(found.map_id, found.id)
    return list(folder.iterdir()) if folder.exists() else []


def test_returns_stay_where_images_are_missing(mapped):
    for path in images_of(mapped, "monday"):
        path.unlink()
    keep(mapped, raw_scans="drop")
    assert mapped.get(DRIVE).json()["scans_without_returns"] == 0


def test_damaged_images_of_dropped_returns_end_the_build_and_those_of_others_are_made_anew(mapped):
    keep(mapped, raw_scans="drop")
    build(mapped, base="live", add=["tuesday"])
    (of_monday,), (of_tuesday,) = images_of(mapped, "monday"), images_of(mapped, "tuesday")
    whole = of_monday.read_bytes()
    of_tuesday.write_bytes(of_tuesday.read_bytes()[:5000])
    build(mapped, base="live", add=["tuesday"])
    assert of_monday.read_bytes() == whole
    of_monday.write_bytes(whole[:5000])
    queued = mapped.post(f"{MAP}/builds", json={"base": "live", "add": ["tuesday"]}).json()
    job = wait_for(mapped, queued["job"])
    assert (job["state"], job["error"]["type"]) == ("failed", "/problems/corrupt-images")
    assert "dropped after a build" in job["error"]["detail"]
    of_monday.unlink()
    refused = mapped.post(f"{MAP}/builds", json={"base": "live", "add": ["tuesday"]})
    assert problem_of(refused) == (409, "returns-gone")


def test_a_backup_holds_what_is_kept_and_a_restore_answers(mapped, tmp_path):
    keep(mapped, raw_scans="drop")
    build(mapped, drives=["tuesday"], **PLAIN)
    done = write_backup(mapped.service.settings.data_dir, tmp_path / "backup.tar")
    assert done.damaged == ()
    restore_backup(tmp_path / "backup.tar", tmp_path / "restored")
    with running(tmp_path / "restored") as again:
        assert again.get(DRIVE).json()["scans_without_returns"] == 16
        found = localize(again, "scan", content=kitti(recording().scans[4]), headers=KITTI)
        assert found["best"]["scan_index"] == 4
        # The images are in the backup where the returns are gone, and only there.
        assert (
            images_of(again, "monday")[0].read_bytes()
            == images_of(mapped, "monday")[0].read_bytes()
        )
        assert images_of(mapped, "tuesday")
        assert not images_of(again, "tuesday")
        assert build(again, base="live", add=["tuesday"])["state"] == "done"
