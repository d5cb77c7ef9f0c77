"""Where among all maps: queries that name no map."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from app.localization import all_maps
from app.revisions.loaded import LoadedRevisions
from core.encodings.signature import pack_signatures
from storage.errors import MapNotFound
from storage.formats.scans.registry import read_scan
from tests.support.access import ADMIN, ADMIN_KEY, LOCALIZE, READ, WRITE, holder
from tests.support.all_maps import ask, import_again, index_maps, packed, shared_basis
from tests.support.campus import PACKED, basis_of
from tests.support.city import DISTRICTS, SCANS, district
from tests.support.recording import KITTI, kitti
from tests.support.service import copy_of, damage, problem_of, running


@pytest.fixture(scope="module")
def client(city, tmp_path_factory):
    with running(copy_of(city, tmp_path_factory.mktemp("among") / "data")) as client:
        yield client


@pytest.fixture
def own(city, tmp_path):
    with running(copy_of(city, tmp_path / "data")) as client:
        yield client


def test_a_signature_is_found_in_the_map_that_it_is_of(client):
    basis = shared_basis(client)
    for slug in ("north", "south"):
        again = district(slug, noise_seed=5)
        for index in range(0, SCANS, 8):
            answer = ask(client, "signature?k=3", packed(basis, again.scans[index]), PACKED).json()
            assert (answer["map"], answer["best"]["map"]) == (slug, slug)
            place, true = answer["best"]["pose"], again.pose(index)
            assert np.hypot(place["x_m"] - true.x_m, place["y_m"] - true.y_m) < 3.0
            assert len(answer["matches"]) == 3
            assert (answer["maps_searched"], answer["maps_not_searched"]) == (2, 2)
            assert answer["not_searched"] == [
                {"map": "east", "reason": "no_live_revision"},
                {"map": "west", "reason": "other_basis"},
            ]


@pytest.mark.parametrize("kind", ["signature", "scan"])
def test_a_query_whose_maps_are_all_deleted_meanwhile_can_be_sent_again(client, monkeypatch, kind):
    scan, basis = district("north").scans[17], shared_basis(client)
    sent = (packed(basis, scan), PACKED) if kind == "signature" else (kitti(scan), KITTI)

    def deleted(_, slug, **_options):
        raise MapNotFound(f"there is no map {slug!r}")

    monkeypatch.setattr(LoadedRevisions, "live", deleted)
    assert problem_of(ask(client, kind, *sent)) == (503, "storage-busy")


def test_a_scan_is_found_in_any_map(client):
    for slug in DISTRICTS:
        scan = district(slug, noise_seed=5).scans[17]
        answer = ask(client, "scan", kitti(scan), KITTI).json()
        assert answer["map"] == slug
        assert abs(answer["best"]["scan_index"] - 17) <= 1
        assert answer["maps_searched"] == 3
        assert answer["not_searched"] == [{"map": "east", "reason": "no_live_revision"}]
        alone = client.post(
            f"/v1/maps/{slug}/localizations/scan", content=kitti(scan), headers=KITTI
        ).json()
        for name, value in alone["best"].items():
            assert answer["best"][name] == value
        assert answer["best"]["revision"] == alone["revision"]
        assert answer["ratio"] >= alone["ratio"]


def test_the_runner_up_may_be_in_another_map(client):
    basis = shared_basis(client)
    scans = district("north", noise_seed=5).scans
    found = [
        ask(client, "signature", packed(basis, scan), PACKED).json()["runner_up"]
        for scan in scans[::4]
    ]
    assert {one["map"] for one in found} == {"north", "south"}


def test_maps_of_one_basis_are_searched_by_their_index(own, monkeypatch):
    basis = shared_basis(own)
    asked = {
        slug: packed(basis, district(slug, noise_seed=5).scans[12]) for slug in ("north", "south")
    }
    opened = [ask(own, "signature?k=2", body, PACKED).json() for body in asked.values()]
    index_maps(own, monkeypatch)
    found = [ask(own, "signature?k=2", body, PACKED).json() for body in asked.values()]
    assert found == opened
    monkeypatch.setattr("app.localization.all_maps._LIKELY", 1)
    for slug, body in asked.items():
        assert ask(own, "signature", body, PACKED).json()["map"] == slug
    scan = kitti(district("west", noise_seed=5).scans[12])
    assert ask(own, "scan", scan, KITTI).json()["map"] == "west"


@pytest.mark.parametrize("indexed", [False, True])
def test_signatures_that_do_not_fit_their_basis_are_refused(own, monkeypatch, indexed):
    if indexed:
        index_maps(own, monkeypatch)
    basis = shared_basis(own)
    [whole] = basis.encode(basis.image(district("north", noise_seed=5).scans[12]))
    of = {"values_real": whole.values.real, "values_imag": whole.values.imag}
    sent = {name: part.tolist() for name, part in of.items()}
    paper = {"segment": 0, "values": sent["values_real"]}
    large = {name: np.pad(part, ((0, 5), (0, 33))).tolist() for name, part in of.items()}
    wide = {name: np.pad(part, ((0, 0), (0, 33))).tolist() for name, part in of.items()}
    high = {name: np.pad(part, ((0, 33), (0, 0))).tolist() for name, part in of.items()}
    for signatures in ([sent, sent], [large], [wide], [high], [paper]):
        body = {"revision": whole.revision, "signatures": signatures}
        refused = own.post("/v1/localizations/signature", json=body)
        assert problem_of(refused) == (422, "invalid-signature"), refused.text
    assert own.post("/v1/localizations/signature", json={**body, "signatures": [sent]}).is_success


def test_a_signature_may_name_a_live_revision_in_place_of_its_basis(client):
    basis = shared_basis(client)
    [made] = basis.encode(basis.image(district("south", noise_seed=5).scans[12]))
    of = {"values_real": made.values.real.tolist(), "values_imag": made.values.imag.tolist()}
    live = {slug: client.get(f"/v1/maps/{slug}").json()["live_revision"] for slug in DISTRICTS}

    def answer(**named):
        return client.post("/v1/localizations/signature", json={**named, "signatures": [of]})

    by_basis = answer(basis=basis.digest).json()
    assert (by_basis["map"], by_basis["maps_searched"]) == ("south", 2)
    for named in (live["north"], live["south"], live["south"][:16]):
        assert answer(revision=named).json() == by_basis
    unknown = answer(revision="0" * 64)
    assert problem_of(unknown) == (409, "stale-signature")
    assert unknown.json()["detail"].startswith("no map that this key may see has a live revision")


@pytest.mark.parametrize("mounting", [None, "1.2,0,1.9,0,2,0"])
def test_a_scan_is_read_once_for_maps_of_several_sensor_heights(own, monkeypatch, mounting):
    for number, height_m in enumerate((1.3, 1.5)):
        import_again(own, "south", f"south-{number}", sensor_height_m=height_m)
    read = Mock(wraps=read_scan)
    monkeypatch.setattr("app.localization.scan_queries.read_scan", read)
    body, options = kitti(district("south", noise_seed=5).scans[12]), {}
    if mounting is not None:
        options["params"] = {"mounting": mounting}
    answer = ask(own, "scan?k=3", body, KITTI, **options).json()
    assert (answer["maps_searched"], read.call_count) == (5, 1)
    for found in answer["matches"]:
        of_map = f"/v1/maps/{found['map']}/localizations/scan"
        alone = own.post(f"{of_map}?k=3", content=body, headers=KITTI, **options).json()
        assert found["distance"] in [one["distance"] for one in alone["matches"]]


def test_maps_that_are_deleted_or_replaced_meanwhile_are_not_counted_as_searched(own, monkeypatch):
    scan, basis = district("north").scans[17], shared_basis(own)
    live = LoadedRevisions.live

    def changed(revisions, slug, **options):
        if slug == "west":
            raise MapNotFound("there is no map 'west'")
        return live(revisions, "west" if slug == "south" else slug, **options)

    monkeypatch.setattr(LoadedRevisions, "live", changed)
    by_scan = ask(own, "scan", kitti(scan), KITTI).json()
    assert (by_scan["maps_searched"], by_scan["maps_not_searched"]) == (2, 2)
    assert {"map": "west", "reason": "no_live_revision"} in by_scan["not_searched"]
    by_signature = ask(own, "signature", packed(basis, scan), PACKED).json()
    assert (by_signature["maps_searched"], by_signature["maps_not_searched"]) == (1, 3)
    assert {"map": "south", "reason": "other_basis"} in by_signature["not_searched"]


def test_a_basis_that_no_map_has_is_stale(client):
    basis = shared_basis(client)
    body = bytearray(packed(basis, district("north").scans[0]))
    body[1:9] = bytes(8)
    assert problem_of(ask(client, "signature", bytes(body), PACKED)) == (409, "stale-signature")


def test_a_signature_of_a_segment_that_no_map_has_is_refused(built, tmp_path):
    with running(copy_of(built.data_dir, tmp_path / "data")) as paper:
        basis = basis_of(paper)
        [first, *_] = basis.encode(basis.image(district("north").scans[0]))
        lacking = pack_signatures([replace(first, segment=77)])
        refused = ask(paper, "signature", lacking, PACKED)
    assert problem_of(refused) == (422, "unknown-segment")
    assert refused.json()["detail"] == "there is no segment 77; the map has 0..2"


def test_queries_of_no_map_and_of_none_with_a_revision_are_refused(tmp_path):
    with running(tmp_path / "data") as client:
        body = kitti(district("north").scans[0])
        assert problem_of(ask(client, "scan", body, KITTI)) == (404, "map-not-found")
        client.post("/v1/maps", json={"map": "empty"})
        assert problem_of(ask(client, "scan", body, KITTI)) == (409, "no-live-revision")


def test_a_key_of_some_maps_learns_nothing_of_others(city, tmp_path):
    with running(copy_of(city, tmp_path / "data"), admin_key=ADMIN_KEY) as client:
        fleet = holder(client, LOCALIZE, READ, maps=["south"])
        basis = shared_basis(client, headers=fleet)
        body = packed(basis, district("north", noise_seed=5).scans[9])
        answer = ask(client, "signature", body, {**PACKED, **fleet}).json()
        assert answer["map"] == "south"
        assert not answer["localized"]
        assert (answer["maps_searched"], answer["maps_not_searched"]) == (1, 0)
        assert "north" not in str(answer)
        scan = kitti(district("north", noise_seed=5).scans[9])
        answer = ask(client, "scan", scan, {**KITTI, **fleet}).json()
        assert (answer["map"], answer["maps_searched"]) == ("south", 1)
        other = holder(client, LOCALIZE, maps=["elsewhere"])
        refused = ask(client, "signature", body, {**PACKED, **other})
        assert problem_of(refused) == (404, "map-not-found")
        west = holder(client, LOCALIZE, maps=["west"])
        refused = ask(client, "signature", body, {**PACKED, **west})
        assert problem_of(refused) == (409, "stale-signature")
        writer = holder(client, WRITE, maps=["north"])
        sent = {"name": "mine", "maps": ["north"]}
        assert problem_of(client.post("/v1/bases", json=sent, headers=writer))[0] == 403
        assert problem_of(client.delete("/v1/bases/city", headers=writer))[0] == 403
        assert client.get("/v1/bases", headers=ADMIN).json()["items"][0]["name"] == "city"


def test_queries_of_a_limited_key_sort_its_maps_once_and_no_others(city, tmp_path, monkeypatch):
    split = Mock(side_effect=all_maps._split)
    monkeypatch.setattr(all_maps, "_split", split)
    with running(copy_of(city, tmp_path / "data"), admin_key=ADMIN_KEY) as client:
        basis, scan = shared_basis(client, headers=ADMIN), district("south").scans[17]
        limits = ["south"], ["north", "south"]
        keys = [holder(client, LOCALIZE, maps=maps) for maps in limits]
        for key, maps in zip(keys * 2, limits * 2, strict=True):
            answer = ask(client, "signature", packed(basis, scan), PACKED | key).json()
            assert answer["maps_searched"] == len(maps)
        sorted_maps = [[one.slug for one in call.args[0]] for call in split.call_args_list]
        assert sorted_maps == [["south"], ["north", "south"]]


def test_a_map_that_cannot_be_read_is_listed_and_logged_once_and_the_others_answer(own, caplog):
    record = own.service.store.revisions.live("south")
    damage(own.service.store.revisions.path_of(record), b"nothing")
    basis = shared_basis(own)
    body = packed(basis, district("north", noise_seed=5).scans[9])
    for _ in range(3):
        answer = ask(own, "signature", body, PACKED).json()
        assert answer["map"] == "north"
        assert {"map": "south", "reason": "damaged"} in answer["not_searched"]
    [record] = [record for record in caplog.records if record.name == "tensormap.localization"]
    assert record.getMessage().startswith("map south cannot be searched: ")
    assert not record.exc_info
