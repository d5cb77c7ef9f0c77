"""Deleted maps and drives: listed, restored, purged and removed when their time is over."""

import json
import time
from datetime import UTC, datetime, timedelta
from os import walk

import pytest
from typer.testing import CliRunner

from app import collector
from app.cli.main import cli
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.catalog import Act, on_behalf
from storage.catalog.models import Recycled
from storage.errors import NotInRecycleBin
from storage.store import Store
from storage.store.verification import verify
from tests.support.access import ADMIN, ADMIN_KEY, READ, WRITE, holder
from tests.support.campus import MAP, acts, build
from tests.support.process import until
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running
from tests.support.tracks import new_track

BIN = "/v1/recycle-bin"
SCAN = f"{MAP}/localizations/scan"


def entries(client, **options):
    return client.get(BIN, **options).json()["items"]


def located(client):
    return client.post(SCAN, content=kitti(recording().scans[20]), headers=KITTI)


def test_a_deleted_map_answers_as_deleted_and_is_restored_with_its_answers(own):
    before, drive = located(own).json(), own.get(f"{MAP}/drives/monday").json()
    taken = own.service.store.stored_bytes()
    assert own.delete(MAP).status_code == 204
    assert problem_of(own.get(MAP)) == problem_of(located(own)) == (404, "map-not-found")
    assert own.get("/v1/maps").json()["items"] == own.get("/v1/jobs").json()["items"] == []
    assert own.service.store.stored_bytes() == taken
    [entry] = entries(own)
    assert (entry["kind"], entry["map"], entry["drive"]) == ("map", "campus", None)
    assert entry["size_bytes"] == sum(taken.values())
    kept = datetime.fromisoformat(entry["kept_until"]) - datetime.fromisoformat(entry["deleted_at"])
    assert kept == timedelta(days=7)
    restored = own.post(f"{BIN}/{entry['entry']}/restore")
    assert restored.json() == {"kind": "map", "map": "campus", "drive": None}
    assert restored.headers["Location"] == MAP
    assert located(own).json()["best"] == before["best"]
    assert own.get(f"{MAP}/drives/monday").json() == drive
    assert entries(own) == []
    assert [action for _, action, _ in acts(own)[-2:]] == ["delete_map", "restore_deleted"]


def test_a_name_is_free_while_its_drive_is_in_the_bin_and_then_a_conflict(own):
    own.delete(f"{MAP}/drives/monday")
    put = own.put(
        f"{MAP}/drives/monday/scans/3", content=kitti(recording().scans[3]), headers=KITTI
    )
    assert put.status_code == 201
    [entry] = entries(own)
    path = f"{BIN}/{entry['entry']}"
    assert problem_of(own.post(f"{path}/restore")) == (409, "drive-exists")
    restored = own.post(f"{path}/restore?name=monday-before")
    assert restored.headers["Location"] == f"{MAP}/drives/monday-before"
    scans = {one["drive"]: one["scans"] for one in own.get(f"{MAP}/drives").json()["items"]}
    assert scans == {"monday": 1, "monday-before": len(recording().scans)}
    assert problem_of(own.post(f"{path}/restore")) == (404, "not-in-recycle-bin")


def test_purging_needs_the_administrator(guarded):
    client, writer = guarded, holder(guarded, READ, WRITE, maps=["yard", "new"])
    for name in ("yard", "lake"):
        client.post("/v1/maps", json={"map": name}, headers=holder(client, WRITE))
    refused = client.delete("/v1/maps/yard?purge=true", headers=writer)
    assert problem_of(refused) == (403, "scope-missing")
    assert client.delete("/v1/maps/yard", headers=writer).status_code == 204
    assert client.delete("/v1/maps/lake", headers=holder(client, WRITE)).status_code == 204
    lake, yard = entries(client, headers=holder(client, READ))
    assert entries(client, headers=writer) == [yard]
    hidden = client.post(f"{BIN}/{lake['entry']}/restore", headers=writer)
    assert problem_of(hidden) == (404, "not-in-recycle-bin")
    elsewhere = client.post(f"{BIN}/{yard['entry']}/restore?name=lake", headers=writer)
    assert problem_of(elsewhere) == (403, "scope-missing")
    purged = client.delete(f"{BIN}/{yard['entry']}", headers=writer)
    assert problem_of(purged) == (403, "scope-missing")


def test_a_job_of_a_deleted_map_is_found_by_keys_that_see_the_map_in_the_bin(tmp_path, built):
    with running(copy_of(built.data_dir, tmp_path / "data"), admin_key=ADMIN_KEY) as client:
        sees, sees_not = (holder(client, READ, maps=[name]) for name in ("campus", "dock"))
        assert client.delete(MAP, headers=ADMIN).status_code == 204
        path = f"/v1/jobs/{built.job}"
        shown = client.get(path, headers=sees).json()
        assert (shown["map"], shown["state"]) == ("campus", "done")
        assert problem_of(client.get(path, headers=sees_not)) == (404, "job-not-found")
        assert client.get("/v1/jobs", headers=sees).json()["items"] == []
        assert client.delete(f"{MAP}?purge=true", headers=ADMIN).status_code == 404
        [entry] = entries(client, headers=ADMIN)
        assert client.delete(f"{BIN}/{entry['entry']}", headers=ADMIN).status_code == 204
        assert problem_of(client.get(path, headers=sees)) == (404, "job-not-found")


def test_a_purge_removes_rows_and_files_and_is_logged(own):
    store = own.service.store
    folder = store.layout.map(store.maps.get("campus").id)
    own.post("/v1/maps", json={"map": "yard"})
    assert own.delete("/v1/maps/yard?purge=true").status_code == 204
    assert entries(own) == []
    own.delete(f"{MAP}/drives/monday")
    [entry] = entries(own)
    assert own.delete(f"{BIN}/{entry['entry']}").status_code == 204
    assert list((folder / "drives").iterdir()) == []
    own.delete(MAP)
    [entry] = entries(own)
    assert folder.exists()
    assert own.delete(f"{BIN}/{entry['entry']}").status_code == 204
    assert not folder.exists()
    assert [what for _, *what in acts(own)[-4:]] == [
        ["delete_drive", ""],
        ["purge_deleted", "drive monday of map campus"],
        ["delete_map", ""],
        ["purge_deleted", "map campus"],
    ]


def test_what_was_deleted_long_ago_is_removed_and_what_is_younger_stays(own):
    own.delete(f"{MAP}/drives/monday")
    own.post("/v1/maps", json={"map": "yard"})
    own.delete("/v1/maps/yard")
    yard, monday = entries(own)
    with own.service.store.catalog._database.writing() as session:
        row = session.get_one(Recycled, monday["entry"])
        row.created_at = datetime.now(UTC) - timedelta(days=7, minutes=1)
    own.service.collector.collect()
    assert entries(own) == [yard]
    assert acts(own)[-1] == ("service", "purge_deleted", "drive monday of map campus")


def deleted_in_1970(folder):
    """Return the entry of a map that a service deleted then, which has stopped."""
    with running(folder) as client:
        client.post("/v1/maps", json={"map": "old"})
        client.delete("/v1/maps/old")
        [entry] = entries(client)
    with Store(folder) as store, store.catalog._database.writing() as session:
        row = session.get_one(Recycled, entry["entry"])
        row.created_at = datetime(1970, 1, 1, tzinfo=UTC)
    return entry["entry"]


def test_after_the_clock_was_set_nothing_that_was_deleted_is_removed(tmp_path, caplog):
    entry = deleted_in_1970(tmp_path)
    # As a service left it that ran in 1970, before its machine had the time from a network.
    (tmp_path / "clock.json").write_text('{"at_s": 0.0, "waits_s": 0.0}')
    for _ in range(2):
        with running(tmp_path) as client:
            client.service.collector.collect()
            assert [found["entry"] for found in entries(client)] == [entry]
    assert caplog.text.count("was expected at 1970-01-01") == 1
    (tmp_path / "clock.json").unlink()
    with running(tmp_path) as client:
        client.service.collector.collect()
        assert entries(client) == []


@pytest.mark.parametrize("what", ["/drives/monday", ""])
def test_a_purge_that_a_crash_interrupted_ends_at_the_next_start_whatever_the_clock_says(
    tmp_path, built, what
):
    data = copy_of(built.data_dir, tmp_path / "data")
    with Store(data) as store:
        bin_of = store.catalog.recycle_bin
        act = Act("operator", "purge_deleted", MAP + what, "campus")
        with on_behalf(act):
            if what:
                entry = bin_of.put_drive("campus", "monday", purging=True)
            else:
                entry = bin_of.put_map("campus", purging=True)
        [purge] = store.catalog.purges.begun()
        assert store.catalog.purges.remove_some(purge, rows=5)
        folder = store.layout.drive(entry.map_id, entry.id) if what else store.layout.map(entry.id)
    (data / "clock.json").write_text('{"at_s": 0.0, "waits_s": 0.0}')
    with running(data) as client:
        until(lambda: not client.service.store.catalog.purges.begun(), "the purge does not go on")
        assert not client.service.store.clock.is_trusted()
        assert not folder.exists()
        assert problem_of(client.get(f"{MAP}{what}"))[0] == 404
        assert problem_of(client.post(f"{BIN}/{entry.id}/restore")) == (404, "not-in-recycle-bin")
        assert [action for _, action, _ in acts(client)].count("purge_deleted") == 1
        assert verify(client.service.store).findings == ()
        assert not (data / "orphans").exists()


def test_a_wait_for_the_clock_ends_soon_after_its_time_and_not_with_the_next_hour(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(collector, "_LOOKS_EVERY_S", 0.05)
    deleted_in_1970(tmp_path)
    (tmp_path / "clock.json").write_text(json.dumps({"at_s": time.time(), "waits_s": 0.3}))
    with running(tmp_path) as client:
        until(lambda: entries(client) == [], "the clock is not looked at again")


@pytest.mark.parametrize("what", ["/drives/monday", ""])
def test_without_days_what_is_deleted_is_removed_at_once(tmp_path, what):
    with running(tmp_path, recycle_bin_days=0) as client:
        client.post("/v1/maps", json={"map": "campus"})
        url = f"{MAP}/drives/monday/scans/0"
        client.put(url, content=kitti(recording().scans[0]), headers=KITTI)
        client.delete(f"{MAP}{what}")
        until(lambda: not any(files for *_, files in walk(tmp_path / "maps")), "its files stay")
        assert entries(client) == []


def test_backup_verification_and_start_know_what_is_in_the_bin(own, tmp_path):
    own.delete(f"{MAP}/drives/monday")
    store = own.service.store
    assert verify(store).findings == ()
    [chunk, *_] = (store.layout.maps).rglob("chunks/*.h5")
    written = write_backup(store.layout.data_dir, tmp_path / "backup.tar")
    assert (written.damaged, written.missing) == ((), ())
    restore_backup(tmp_path / "backup.tar", tmp_path / "new")
    with Store.serving(tmp_path / "new") as restored:
        assert not restored.layout.orphans.exists()
        assert verify(restored, repair=True).findings == ()
        [entry] = restored.recycle_bin.list().items
        restored.recycle_bin.restore(entry.id)
        assert restored.drives.read_scan("campus", "monday", 20).points_m.size
        restored.drives.delete("campus", "monday")
        path = restored.layout.data_dir / chunk.relative_to(store.layout.data_dir)
        content = path.read_bytes()
        path.chmod(0o600)
        half = len(content) // 2
        path.write_bytes(content[:half] + b"damaged!" + content[half + 8 :])
        [found, *_] = verify(restored, repair=True).findings
        assert found.described.startswith("map campus, drive monday,")
        assert "good scans have a new file" in found.done


def test_a_restored_service_removes_nothing_for_its_age_until_it_has_run_for_a_day(
    own, tmp_path, monkeypatch
):
    own.delete(f"{MAP}/drives/monday")
    write_backup(own.service.settings.data_dir, tmp_path / "backup.tar")
    restore_backup(tmp_path / "backup.tar", tmp_path / "new")
    # The backup is as old as what is in its bin: who restores it may want that.
    with running(tmp_path / "new", recycle_bin_days=0) as client:
        assert not client.service.collector.collect()
        [entry] = entries(client)
        assert client.post(f"{BIN}/{entry['entry']}/restore").status_code == 200
        client.delete(f"{MAP}/drives/monday")
        day_later = time.monotonic() + 86_400.0
        monkeypatch.setattr(client.service.store.clock, "_monotonic", lambda: day_later)
        monkeypatch.setattr(client.service.store.clock, "_wall", lambda: time.time() + 86_400.0)
        assert client.service.collector.collect()
        assert entries(client) == []


def test_the_commands_list_restore_and_purge(own):
    own.delete(f"{MAP}/drives/monday")
    [entry] = entries(own)
    data = ["--data", str(own.service.settings.data_dir)]

    def run(*words):
        result = CliRunner().invoke(cli, ["recycle-bin", *words, *data])
        assert result.exit_code == 0, result.output
        return result.output

    def shown():
        result = CliRunner().invoke(cli, ["recycle-bin", "list", *data])
        return result.stdout, result.stderr

    assert f"{entry['entry']}  drive monday of map campus" in run("list")
    assert "is restored" in run("restore", entry["entry"], "--name", "sunday")
    assert own.get(f"{MAP}/drives/sunday").status_code == 200
    own.delete(f"{MAP}/drives/sunday")
    assert "is removed" in run("purge", entry["entry"])
    assert shown() == ("", "nothing is in the recycle bin\n")
    assert [key for key, action, _ in acts(own) if action == "purge_deleted"] == ["operator"]
    for word in ("restore", "purge"):
        refused = CliRunner().invoke(cli, ["recycle-bin", word, entry["entry"], *data])
        assert isinstance(refused.exception, NotInRecycleBin)
        last = own.get("/v1/audit").json()["items"][-1]
        assert (last["key"], last["action"]) == ("operator", f"{word}_deleted")
        assert (last["subject"], last["outcome"]) == (f"{BIN}/{entry['entry']}", "404")


def test_recall_is_measured_on_a_drive_that_was_restored_under_another_name(own):
    own.delete(f"{MAP}/drives/monday")
    [deleted] = entries(own)
    own.post(f"{BIN}/{deleted['entry']}/restore?name=first")
    live, _ = (item["revision"] for item in own.get(f"{MAP}/revisions").json()["items"][::-1])
    job = build(own, encoding="paper", segments=3, make_live=True)
    assert job["gate"]["compared_with"] == live
    assert (job["gate"]["asked_new"], job["gate"]["live"]) == (48, True), job["gate"]
    assert job["gate"]["recall_of_live"] == job["gate"]["recall_of_new"]


@pytest.mark.parametrize("how", ["", "?purge=true"])
def test_tracks_of_a_deleted_map_leave_the_limit_of_their_key(built, tmp_path, how):
    with running(copy_of(built.data_dir, tmp_path / "data"), max_tracks_per_key=1) as client:
        revision = client.get(f"{MAP}/revisions/{built.live}/file").content
        track = new_track(client)
        assert problem_of(client.post(f"{MAP}/tracks")) == (429, "too-many-tracks-of-key")
        assert client.delete(f"{MAP}{how}").status_code == 204
        client.post("/v1/maps", json={"map": "campus"})
        media_type = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
        client.post(f"{MAP}/revisions", content=revision, headers=media_type)
        assert problem_of(client.get(track)) == (404, "track-not-found")
        new_track(client)
    with running(tmp_path / "data", max_tracks_per_key=2) as client:
        new_track(client)
        assert len(client.get(f"{MAP}/tracks").json()["items"]) == 2
