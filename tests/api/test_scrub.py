"""Damage is detected in the background, by name, in the log and the metrics; all else is served."""

import json
import logging
import math
import time
from unittest.mock import Mock

import h5py
import pytest

from app.http.metrics import Metrics
from app.scrub import Scrub
from storage.errors import StorageUnavailable
from storage.store import Store
from tests.support.process import until
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, damage, problem_of, running
from tests.support.workers import never_end

DAY_S = 86_400
AT_ONCE = 1e-9


def value(metrics_text, name):
    [line] = [line for line in metrics_text.splitlines() if line.startswith(f"{name} ")]
    return float(line.rpartition(" ")[2])


@pytest.fixture
def data(tmp_path, built):
    return copy_of(built.data_dir, tmp_path / "data")


def live_file(data, built):
    [path] = data.rglob(f"{built.live}*")
    return path


def spoil(path):
    content = path.read_bytes()
    damage(path, content)  # a file of its own, where copies share theirs
    with h5py.File(path, "r+") as file:
        file["signatures"][0] += 1.0


def test_a_pass_finds_what_is_damaged_and_names_it_each_time(data, built, caplog):
    spoil(live_file(data, built))
    metrics = Metrics()
    with Store(data) as store:
        scrub = Scrub(store, metrics, AT_ONCE)
        for passes in (1, 2):
            caplog.clear()
            with caplog.at_level(logging.INFO, "tensormap.scrub"):
                scrub.run_pass()
            text = metrics.render(store, 0).decode()
            assert value(text, 'tensormap_scrub_files_total{result="damaged"}') == passes
            assert value(text, 'tensormap_scrub_files_total{result="good"}') == passes * 5
            assert value(text, "tensormap_scrub_damaged_files") == 1
            assert value(text, "tensormap_scrub_last_pass_timestamp_seconds") > 1e9
            [answer] = [record for record in caplog.records if record.levelno == logging.ERROR]
            assert live_file(data, built).name in answer.tensormap_fields["file"]
            assert answer.tensormap_fields["of"] == f"map campus, revision {built.live[:12]}"
    assert live_file(data, built).exists()


def test_what_is_damaged_is_refused_by_name_and_the_rest_serves(data, built):
    spoil(live_file(data, built))
    with running(data, scrub_days=AT_ONCE) as client:
        while value(client.get("/metrics").text, "tensormap_scrub_damaged_files") < 1:
            pass
        body = kitti(recording().scans[5])
        requested = "/v1/maps/campus/localizations/scan"
        assert problem_of(client.post(requested, content=body, headers=KITTI)) == (
            500,
            "corrupt-file",
        )
        rolled = client.put("/v1/maps/campus/live", json={"revision": built.other})
        assert rolled.status_code == 200
        assert client.post(requested, content=body, headers=KITTI).json()["best"]["scan_index"] == 5
        assert client.get("/v1/maps/campus/drives/monday/scans/5").status_code == 200


def test_a_pass_continues_after_a_start_where_it_stopped(data):
    with Store(data) as store:
        counted = []
        for done in (0, 4):
            paths = sorted(path for path in Scrub(store, Metrics(), 1)._inventory.paths())
            state = {"checked_at_s": 0.0, "passed_at_s": 1.0, "bad": {paths[0]: "x", "gone": "y"}}
            after = {"after": paths[done - 1] if done else ""}
            if done:
                damage(data / paths[0], b"no scans")
            (data / "scrub.json").write_text(json.dumps({**state, **after}))
            metrics = Metrics()
            scrub = Scrub(store, metrics, AT_ONCE)
            scrub.start()
            while "_timestamp_seconds 1.0" in metrics.render(store, 0).decode():
                pass
            scrub.stop()
            text = metrics.render(store, 0).decode()
            counted.append(value(text, "tensormap_scrub_damaged_files"))
    assert counted == [0, 1]  # what was found before the start is still known


@pytest.mark.parametrize("mend", ["restored", "gone with its map"])
def test_what_is_mended_is_damaged_no_longer_before_the_next_pass(data, built, mend, caplog):
    """An alert that nobody can clear for a month is switched off."""
    caplog.set_level(logging.INFO, "tensormap.scrub")
    path = live_file(data, built)
    whole = path.read_bytes()
    spoil(path)
    with Store(data) as store:
        Scrub(store, Metrics(), AT_ONCE).run_pass()
        metrics = Metrics()
        scrub = Scrub(store, metrics, 30.0)
        scrub.start()
        scrub.stop()
        assert value(metrics.render(store, 0).decode(), "tensormap_scrub_damaged_files") == 1

        if mend == "restored":
            damage(path, whole)
        else:
            store.maps.purge("campus")
        scrub = Scrub(store, metrics, 30.0)
        scrub.start()
        read = metrics.render
        until(lambda: "damaged_files 0.0" in read(store, 0).decode(), "it is still damaged")
        scrub.stop()
        assert json.loads((data / "scrub.json").read_text())["bad"] == {}
        text = metrics.render(store, 0).decode()
        assert value(text, 'tensormap_scrub_files_total{result="good"}') == 0  # of the pass only
    fields = caplog.records[-1].tensormap_fields
    assert (caplog.records[-1].getMessage(), fields["file"]) == (
        "a stored file is damaged no longer",
        str(path.relative_to(data)),
    )


@pytest.mark.parametrize(
    "state", [None, {"after": "", "checked_at_s": 0.0, "passed_at_s": 0.0, "bad": {}}]
)
def test_before_the_first_pass_has_ended_its_begin_is_its_time(data, state):
    if state is not None:  # of an earlier version
        (data / "scrub.json").write_text(json.dumps(state))
    with Store(data) as store:
        metrics = Metrics()
        began_s = time.time()
        scrub = Scrub(store, metrics, 1e6)
        scrub.start()
        scrub.stop()
        text = metrics.render(store, 0).decode()
        passed_s = value(text, "tensormap_scrub_last_pass_timestamp_seconds")
        assert began_s <= passed_s <= time.time()


def test_where_nothing_is_checked_there_is_no_time_of_a_pass(data):
    with Store(data) as store:
        metrics = Metrics()
        Scrub(store, metrics, 0.0).start()
        text = metrics.render(store, 0).decode()
    assert math.isnan(value(text, "tensormap_scrub_last_pass_timestamp_seconds"))


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b'{"after": 1}', b"\xff"])
def test_a_state_that_cannot_be_read_begins_a_new_pass(data, content):
    (data / "scrub.json").write_bytes(content)
    with Store(data) as store:
        metrics = Metrics()
        scrub = Scrub(store, metrics, 1e6)
        scrub.start()
        scrub.stop()
        assert value(metrics.render(store, 0).decode(), "tensormap_scrub_damaged_files") == 0


def test_zero_days_check_nothing(data):
    with Store(data) as store:
        scrub = Scrub(store, Metrics(), 0.0)
        scrub.start()
        assert not scrub._thread.is_alive()
        scrub.stop()
    assert not (data / "scrub.json").exists()


def test_an_outage_is_logged_once_however_often_the_check_tries_again(data, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "tensormap.scrub")
    monkeypatch.setattr("app.scrub._RETRY_S", 0.0)
    with Store(data) as store:
        scrub = Scrub(store, Metrics(), AT_ONCE)
        failed = Mock(side_effect=StorageUnavailable("the disk fails"))
        with monkeypatch.context() as patched:
            patched.setattr(scrub._inventory, "paths", failed)
            scrub.start()
            until(lambda: failed.call_count > 3, "it does not try again")
        until(lambda: (data / "scrub.json").exists(), "nothing is checked after it")
        scrub.stop()
    first, second, *_ = (record.getMessage() for record in caplog.records)
    assert first == "the stored files cannot be checked now: the disk fails"
    assert second == "this is over: the stored files cannot be checked now"


def test_a_stop_waits_for_no_file_that_is_checked(data, monkeypatch, caplog):
    monkeypatch.setattr("storage.files.checker._answer_all", never_end)
    metrics = Metrics()
    with Store(data) as store:
        scrub = Scrub(store, metrics, AT_ONCE)
        scrub.start()
        until(lambda: getattr(scrub._checker, "_child", None) is not None, "nothing is checked")
        scrub.stop()
        text = metrics.render(store, 0).decode()
    assert value(text, "tensormap_scrub_damaged_files") == 0
    assert caplog.records == []


def test_a_stop_waits_for_no_damaged_file_that_is_checked_again(data, built, monkeypatch, caplog):
    with Store(data) as store:
        spoil(live_file(data, built))
        Scrub(store, Metrics(), AT_ONCE).run_pass()
        monkeypatch.setattr("storage.files.checker._answer_all", never_end)
        caplog.clear()
        scrub = Scrub(store, Metrics(), AT_ONCE)
        scrub.start()
        until(lambda: getattr(scrub._checker, "_child", None) is not None, "nothing is checked")
        scrub.stop()
    assert caplog.records == []


def test_files_are_spread_over_the_days(data, monkeypatch):
    waits: list[float] = []

    def note(wait_s):
        waits.append(wait_s)
        return True

    with Store(data) as store:
        scrub = Scrub(store, Metrics(), 100 / DAY_S)
        monkeypatch.setattr(scrub, "_wait", note)
        scrub.run_pass()
    assert len(waits) == 6
    assert sum(waits) == pytest.approx(100)


def test_a_store_whose_files_are_all_gone_is_not_checked_again_and_again(tmp_path, monkeypatch):
    with Store(tmp_path / "data") as store:
        store.maps.create("campus")
        scan = recording().scans[0]
        store.drives.put_scan("campus", "monday", 0, scan)
        [path] = (tmp_path / "data").rglob("chunks/*.h5")
        path.unlink()
        scrub = Scrub(store, Metrics(), 1.0)
        waited = []

        def wait(wait_s):
            waited.append(wait_s)
            return True

        monkeypatch.setattr(scrub, "_wait", wait)
        scrub.run_pass()
    assert max(waited) > 0


def test_a_damaged_revision_is_not_sent(data, built):
    spoil(live_file(data, built))
    with running(data) as client:
        path = f"/v1/maps/campus/revisions/{built.live}/file"
        assert problem_of(client.get(path)) == (500, "corrupt-file")
        assert client.get(f"/v1/maps/campus/revisions/{built.other}/file").status_code == 200
