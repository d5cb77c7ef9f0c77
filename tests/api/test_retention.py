"""Retention of revisions, by number and age."""

import threading
from datetime import timedelta

import pytest

from storage.catalog.models import RevisionRecord
from storage.errors import StorageUnavailable
from storage.retention import Retention
from storage.store import Store
from tests.support.campus import MAP, acts, build, keep, localize_packed, signed
from tests.support.process import until
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running

DEFAULT = {"retained_revisions": "all", "retained_for_days": 30.0, "raw_scans": "keep"}
NOTHING = {"retained_revisions": 0, "retained_for_days": 0}


def listed(client):
    return {item["revision"] for item in client.get(f"{MAP}/revisions").json()["items"]}


def files(client):
    store = client.service.store
    folder = store.layout.revisions(store.maps.get("campus").id)
    return {path.name.partition(".")[0] for path in folder.iterdir()}


@pytest.fixture(scope="module")
def with_a_third(tmp_path_factory, built):
    """The data of a stopped service with three revisions, and the newest one's digest."""
    data_dir = copy_of(built.data_dir, tmp_path_factory.mktemp("three") / "data")
    with running(data_dir) as client:
        newest = build(client, segments=5, encoding="paper")["revision"]
    return data_dir, newest


@pytest.fixture
def three(tmp_path, built, with_a_third):
    """A service and its three revisions: the live one, another, and the newest."""
    data_dir, newest = with_a_third
    with running(copy_of(data_dir, tmp_path / "data")) as client:
        yield client, built.live, built.other, newest


def test_a_map_keeps_everything_by_default(three):
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
    answer = keep(own, raw_scans="drop")
    assert answer["retention"] == {
        "retained_revisions": 2,
        "retained_for_days": None,
        "raw_scans": "drop",
    }
    assert answer["retention_in_force"] == {**DEFAULT, "retained_revisions": 2, "raw_scans": "drop"}
    assert answer["description"] == own.get("/v1/maps").json()["items"][0]["description"]
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
def test_an_invalid_policy_is_rejected_and_nothing_changes(client, wrong):
    before = client.get(MAP).json()
    assert problem_of(client.patch(MAP, json=wrong)) == (422, "invalid-request")
    assert client.get(MAP).json() == before


def test_a_revision_that_is_not_retained_goes_and_its_signatures_are_stale(three):
    client, live, other, newest = three
    signature = signed(client, other)
    assert localize_packed(client, signature).status_code == 200
    keep(client, **NOTHING)
    assert listed(client) == files(client) == {live, newest}
    refused = localize_packed(client, signature)
    assert problem_of(refused) == (409, "stale-signature")
    assert live in refused.json()["detail"]
    assert problem_of(client.get(f"{MAP}/revisions/{other}")) == (404, "revision-not-found")
    assert ("service", "collect_revision", f"revision {other}") in acts(client)
    assert client.service.store.audit.verify().fault is None


def test_what_is_not_retained_goes_after_an_error_that_nobody_expected(three, monkeypatch):
    client, live, _, newest = three
    listing, failures = client.service.store.maps.list, [KeyError("a fault of ours")]

    def fail_once(*given, **selected):
        if failures:
            raise failures.pop()
        return listing(*given, **selected)

    monkeypatch.setattr(client.service.store.maps, "list", fail_once)
    client.service.collector.wake()
    until(lambda: not failures, "nothing is collected")
    client.patch(MAP, json={"retention": NOTHING})
    until(lambda: listed(client) == {live, newest}, "nothing is collected any more")


def test_a_change_that_could_not_be_collected_is_looked_at_again_soon(three, monkeypatch):
    client, live, _, newest = three
    store = client.service.store
    listing, failures = store.maps.list, [StorageUnavailable("just now")]

    def fail_once(*given, **selected):
        if failures:
            raise failures.pop()
        return listing(*given, **selected)

    store.maps.update("campus", retention=NOTHING)
    monkeypatch.setattr("app.collector._LOOKS_EVERY_S", 0.1)
    monkeypatch.setattr(store.maps, "list", fail_once)
    client.service.collector.wake("campus")
    until(lambda: listed(client) == {live, newest}, "the change is forgotten")
    assert not failures


def test_after_a_change_only_its_own_map_is_looked_at(three, monkeypatch):
    client, live, _, newest = three
    client.patch(MAP, json={"retention": NOTHING})
    until(lambda: listed(client) == {live, newest}, "nothing is collected at the start")
    store, looked_at = client.service.store, set()
    store.maps.create("yard")
    store.maps.update("yard", retention=NOTHING)
    collectable = store.revisions.collectable

    def noting(map_id, *given):
        looked_at.add(map_id)
        return collectable(map_id, *given)

    monkeypatch.setattr(store.revisions, "collectable", noting)
    client.put(f"{MAP}/live", json={"revision": newest})
    until(lambda: listed(client) == {newest}, "nothing is collected of the map that changed")
    assert looked_at == {store.maps.get("campus").id}
    client.service.collector.collect()
    assert store.maps.get("yard").id in looked_at


def test_a_replaced_revision_stays_for_its_time_and_answers_signatures_of_it(three):
    client, live, other, newest = three
    signature = signed(client, live)
    keep(client, retained_revisions=0, retained_for_days=1)
    client.put(f"{MAP}/live", json={"revision": newest})
    client.service.collector.collect()
    assert listed(client) == {live, other, newest}
    found = localize_packed(client, signature).json()
    assert (found["revision"], found["live_revision"]) == (live, newest)
    with client.service.store.catalog._database.writing() as session:
        row = session.get_one(RevisionRecord, (client.service.store.maps.get("campus").id, live))
        row.retained_from -= timedelta(days=2)
    client.service.collector.collect()
    assert listed(client) == {other, newest}
    assert problem_of(localize_packed(client, signature)) == (409, "stale-signature")


def test_a_build_and_a_change_of_live_collect_by_themselves(own, built):
    own.patch(MAP, json={"retention": NOTHING})
    newest = build(own, segments=5, encoding="paper")["revision"]
    until(lambda: listed(own) == files(own) == {built.live, newest}, "not collected")
    own.put(f"{MAP}/live", json={"revision": newest})
    until(lambda: listed(own) == files(own) == {newest}, "not collected")


def test_a_start_collects_by_the_services_defaults_unless_a_map_chose_otherwise(
    tmp_path, built, with_a_third
):
    data_dir, newest = with_a_third
    for name in ("chose", "did-not"):
        copy_of(data_dir, tmp_path / name)
    with Store(tmp_path / "chose") as store:
        store.maps.update("campus", retention={"retained_revisions": "all"})
    with running(tmp_path / "did-not", **NOTHING) as client:
        until(lambda: listed(client) == files(client) == {built.live, newest}, "not collected")
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
    client.patch("/v1/maps/alpha", json={"retention": NOTHING})
    failing = client.service.store.maps.get("alpha").id
    found = client.service.store.revisions.collectable

    def fail(map_id, policy):
        if map_id == failing:
            raise StorageUnavailable("just now")
        return found(map_id, policy)

    monkeypatch.setattr(client.service.store.revisions, "collectable", fail)
    keep(client, **NOTHING)
    assert listed(client) == {live, newest}
    failed = {one for one in caplog.records if "map alpha" in one.getMessage()}
    assert failed
    assert all(one.getMessage().endswith("just now") for one in failed)
    assert not any(one.exc_info for one in failed)  # one line: nothing of ours is at fault


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
        for number in range(12):
            imported = own.post(
                f"{MAP}/revisions",
                params={"make_live": True},
                content=(body, first)[number % 2],
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
