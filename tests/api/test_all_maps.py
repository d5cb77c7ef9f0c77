"""Where among all maps: shared bases, and queries that name no map."""

import io
import json
import pkgutil
import tempfile
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from app.revisions.loaded import LoadedRevisions
from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from core.scans.scan import Scan
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.errors import MapNotFound
from storage.files.map_file import map_of_bytes, write_map
from storage.formats.scans.registry import read_scan
from storage.store import Store
from storage.store.verification import verify
from tests.support.access import ADMIN, ADMIN_KEY, LOCALIZE, READ, WRITE, holder
from tests.support.campus import NPZ, PACKED, basis_of
from tests.support.city import BUILT, DISTRICTS, SCANS, build_district, district
from tests.support.process import until
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


def shared_basis(client, name="city", **options):
    return BasisOut.model_validate(client.get(f"/v1/bases/{name}", **options).json()).to_core()


def packed(basis, scan):
    return pack_signatures(basis.encode(basis.image(scan)))


def ask(client, kind, content, headers, **options):
    return client.post(f"/v1/localizations/{kind}", content=content, headers=headers, **options)


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


def import_again(client, source, slug, **parameters):
    """Import the live revision of a map into another one, with other parameters."""
    live = client.get(f"/v1/maps/{source}").json()["live_revision"]
    file = client.get(f"/v1/maps/{source}/revisions/{live}/file").content
    if parameters:
        found = map_of_bytes(file, source)
        changed = replace(found, parameters=replace(found.parameters, **parameters))
        with tempfile.TemporaryDirectory() as folder:
            write_map(Path(folder) / "map.h5", changed)
            file = (Path(folder) / "map.h5").read_bytes()
    client.post("/v1/maps", json={"map": slug})
    media_type = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
    imported = client.post(f"/v1/maps/{slug}/revisions", content=file, headers=media_type)
    assert imported.status_code == 201, imported.text


def index_maps(client, monkeypatch):
    monkeypatch.setattr("app.localization.all_maps.FEWEST_MAPS", 2)
    monkeypatch.setattr("app.localization.place_indexes.FEWEST_MAPS", 2)
    digest = client.get("/v1/bases/city").json()["basis"]
    indexes = client.service.indexes

    def is_open():
        # An update that began with the service, for which two maps were few, may remove it once.
        indexes.update(digest)
        return indexes.open(digest) is not None

    until(is_open, "the maps are not indexed")


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


@pytest.mark.parametrize("anchored", [False, True])
def test_a_query_of_more_maps_than_are_kept_leaves_those_that_are(city, tmp_path, anchored):
    with running(copy_of(city, tmp_path / "data"), loaded_revisions=2) as client:
        on_earth = {"latitude_deg": 49.01, "longitude_deg": 8.4, "altitude_m": 115.0}
        anchor = {**on_earth, "heading_deg": 30.0}
        for slug in ("north", "west", "south") if anchored else ():
            client.patch(f"/v1/maps/{slug}", json={"anchor": anchor}).raise_for_status()
        body = kitti(district("south", noise_seed=5).scans[12])
        for slug in ("west", "south"):
            client.post(f"/v1/maps/{slug}/localizations/scan", content=body, headers=KITTI)
        kept = list(client.service.revisions._loaded)
        answer = ask(client, "scan", body, KITTI).json()
        assert answer["maps_searched"] == 3
        assert ("wgs84" in answer["best"]["pose"]) == anchored
        assert list(client.service.revisions._loaded) == kept


def test_the_second_of_two_queries_reads_no_map_and_measures_no_confidence(
    city, tmp_path, monkeypatch
):
    work = []

    def noted(name):
        module, _, function = name.rpartition(".")
        does = getattr(pkgutil.resolve_name(module), function)

        def done(*args):
            work.append(function)
            return does(*args)

        monkeypatch.setattr(name, done)

    noted("storage.store.revisions.read_revision")
    noted("core.mapping.limited_queries.LimitedScans.odds_gained")
    noted("core.mapping.limited_queries.LimitedSignatures.rescaling")
    points_m = district("south", noise_seed=5).scans[12].points_m
    quarter = kitti(Scan(points_m[points_m[:, 0] > np.abs(points_m[:, 1])]))
    with running(copy_of(city, tmp_path / "data"), loaded_revisions=2) as client:
        import_again(client, "north", "east")
        first = ask(client, "scan", quarter, KITTI).json()
        assert first["maps_searched"] == 4
        assert work.count("read_revision") == 4 + 1  # the first, when it was imported
        assert "odds_gained" in work
        work.clear()
        assert ask(client, "scan", quarter, KITTI).json() == first
        assert work == []


@pytest.mark.parametrize("kind", ["signature", "scan"])
def test_maps_that_vehicles_name_stay_in_memory(city, tmp_path, kind):
    with running(copy_of(city, tmp_path / "data"), loaded_revisions=2) as client:
        body = kitti(district("south", noise_seed=5).scans[12])
        for slug in ("west", "north"):
            client.post(f"/v1/maps/{slug}/localizations/scan", content=body, headers=KITTI)
        kept = list(client.service.revisions._loaded)
        basis = shared_basis(client)  # of two maps: as many as are kept
        signature = packed(basis, district("south", noise_seed=5).scans[12])
        sent = (signature, PACKED) if kind == "signature" else (body, KITTI)
        assert ask(client, kind, *sent).json()["map"] == "south"
        assert list(client.service.revisions._loaded) == kept


def test_a_map_that_does_not_fit_leaves_the_room_to_others(city, tmp_path, monkeypatch):
    with running(copy_of(city, tmp_path / "data"), opened_scans=100) as client:
        search = client.service.all_maps
        summaries = client.service.store.catalog.map_summaries.all()
        scans = {"north": 101, "south": 60, "west": 50}
        maps = [replace(of, scans=scans[of.slug]) for of in summaries if of.slug in scans]
        live, kept = search._open_maps.live, {}

        def noted(summary, *, keep):
            kept[summary.slug] = keep
            return live(summary, keep=keep)

        monkeypatch.setattr(search._open_maps, "live", noted)
        list(search._opened(maps, {}))
        assert kept == {"north": False, "south": True, "west": False}


def test_maps_that_are_not_indexed_yet_are_opened_or_listed(city, tmp_path, monkeypatch):
    with running(copy_of(city, tmp_path / "data"), max_maps_opened=1) as client:
        monkeypatch.setattr("app.localization.all_maps.FEWEST_MAPS", 2)
        monkeypatch.setattr(client.service.indexes, "wake", lambda *_: None)
        body = packed(shared_basis(client), district("north", noise_seed=5).scans[12])
        answer = ask(client, "signature", body, PACKED).json()
        assert (answer["map"], answer["maps_searched"]) == ("north", 1)
        assert {"map": "south", "reason": "not_indexed"} in answer["not_searched"]


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


def test_more_maps_than_may_be_opened_are_refused(city, tmp_path):
    with running(copy_of(city, tmp_path / "data"), max_maps_opened=2) as client:
        body = kitti(district("north").scans[0])
        assert problem_of(ask(client, "scan", body, KITTI)) == (422, "too-many-maps")


def test_of_maps_of_one_index_a_basis_is_not_advised_where_fewer_may_be_opened(
    city, tmp_path, monkeypatch
):
    with running(copy_of(city, tmp_path / "data"), max_maps_opened=1) as client:
        index_maps(client, monkeypatch)
        body = packed(shared_basis(client), district("north", noise_seed=5).scans[12])
        refused = ask(client, "signature", body, PACKED)
    assert problem_of(refused) == (422, "too-many-maps")
    advice = "the limit is 1: name a map, or raise TENSORMAP_MAX_MAPS_OPENED"
    assert refused.json()["detail"].endswith(advice)


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


def test_a_shared_basis_has_one_name_and_stays_while_it_is_used(own):
    same = own.post("/v1/bases", json={"name": "city", "maps": ["south"]})
    assert same.status_code == 200
    taken = own.post("/v1/bases", json={"name": "city", "maps": ["west"]})
    assert problem_of(taken) == (409, "basis-exists")
    renamed = own.post("/v1/bases", json={"name": "town", "maps": ["north"]})
    assert problem_of(renamed) == (409, "basis-exists")
    assert problem_of(own.delete("/v1/bases/city")) == (409, "basis-in-use")
    assert problem_of(own.get("/v1/bases/none")) == (404, "basis-not-found")
    assert own.post("/v1/bases", json={"name": "unused", "maps": ["west"]}).status_code == 201
    own.delete("/v1/maps/west")
    assert problem_of(own.delete("/v1/bases/unused")) == (409, "basis-in-use")  # it can be restored
    [deleted] = own.get("/v1/recycle-bin").json()["items"]
    own.delete(f"/v1/recycle-bin/{deleted['entry']}")
    assert own.delete("/v1/bases/unused").status_code == 204
    assert [item["name"] for item in own.get("/v1/bases").json()["items"]] == ["city"]


def test_a_shared_basis_is_the_same_as_json_and_as_npz(client):
    as_json = client.get("/v1/bases/city")
    as_npz = client.get("/v1/bases/city", headers=NPZ)
    assert (as_json.headers["Vary"], as_npz.headers["Vary"]) == ("Accept", "Accept")
    assert as_json.headers["ETag"] != as_npz.headers["ETag"]
    whole = as_json.json()
    with np.load(io.BytesIO(as_npz.content), allow_pickle=False) as arrays:
        assert sorted(arrays) == ["basis", "parameters", "radial_basis", "revision"]
        assert (str(arrays["basis"]), str(arrays["revision"])) == (whole["basis"], "")
        assert json.loads(str(arrays["parameters"])) == whole["parameters"]
        assert arrays["radial_basis"].dtype == np.float32
        assert arrays["radial_basis"].tolist() == whole["radial_basis"]


@pytest.mark.parametrize("headers", [{}, NPZ], ids=["json", "npz"])
def test_a_shared_basis_that_the_vehicle_has_is_not_sent_again(client, headers):
    first = client.get("/v1/bases/city", headers=headers)
    etag, digest = first.headers["ETag"], client.get("/v1/bases/city").json()["basis"]
    assert client.get("/v1/maps/south/basis", headers=headers).headers["ETag"] == etag
    for held in (etag, etag.removeprefix("W/"), f'"another", {etag}', "*"):
        for named in ("city", digest):
            asked = {**headers, "If-None-Match": held}
            again = client.get(f"/v1/bases/{named}", headers=asked)
            assert (again.status_code, again.content) == (304, b"")
            assert again.headers["ETag"] == etag
    other = client.get("/v1/bases/city", headers={**headers, "If-None-Match": '"another"'})
    assert (other.status_code, other.content) == (200, first.content)
    none = client.get("/v1/bases/none", headers={**headers, "If-None-Match": "*"})
    assert problem_of(none) == (404, "basis-not-found")


def test_a_basis_can_be_fitted_to_several_maps(own):
    made = own.post("/v1/bases", json={"name": "both", "maps": ["north", "west"]})
    assert made.status_code == 201, made.text
    digest = made.json()["basis"]
    assert digest not in {own.get(f"/v1/maps/{slug}/basis").json()["basis"] for slug in DISTRICTS}
    build_district(own, "west", basis=digest[:16], make_live=True, force=True)
    assert own.get("/v1/maps/west/basis").json()["basis"] == digest
    [revision, *_] = own.get("/v1/maps/west/revisions").json()["items"]
    assert revision["parameters"]["basis"]["shared"] == digest[:16]
    refused = own.post("/v1/bases", json={"name": "all", "maps": ["north", "east"]})
    assert problem_of(refused) == (409, "no-live-revision")


def test_a_basis_of_a_map_whose_drive_was_deleted_is_refused_until_it_is_restored(own):
    [drive] = own.get("/v1/maps/west/drives").json()["items"]
    own.delete(f"/v1/maps/west/drives/{drive['drive']}")
    refused = own.post("/v1/bases", json={"name": "both", "maps": ["north", "west"]})
    assert problem_of(refused) == (422, "invalid-parameters")
    gone = f"map 'west' is built of drive {drive['drive']!r}, which is no longer stored"
    assert gone in refused.json()["detail"]
    [deleted] = own.get("/v1/recycle-bin").json()["items"]
    own.post(f"/v1/recycle-bin/{deleted['entry']}/restore?name=renamed")
    made = own.post("/v1/bases", json={"name": "both", "maps": ["north", "west"]})
    assert made.status_code == 201, made.text


def test_a_basis_of_an_imported_map_and_another_one_is_refused(own):
    live = own.get("/v1/maps/north").json()["live_revision"]
    file = own.get(f"/v1/maps/north/revisions/{live}/file").content
    media_type = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
    own.post("/v1/maps/east/revisions", content=file, headers=media_type)
    refused = own.post("/v1/bases", json={"name": "both", "maps": ["north", "east"]})
    assert problem_of(refused) == (422, "invalid-parameters")
    assert "map 'east' is built of no drive, but imported" in refused.json()["detail"]


def test_maps_whose_segments_have_bases_of_their_own_get_no_common_one(own):
    built = build_district(own, "west", encoding="paper", lateral_renderings_m=None, views=None)
    own.put("/v1/maps/west/live", json={"revision": built})
    refused = own.post("/v1/bases", json={"name": "both", "maps": ["west", "north"]})
    assert problem_of(refused) == (422, "invalid-parameters")
    assert "map 'west' is in encoding paper, in which each segment" in refused.json()["detail"]


def test_a_basis_that_does_not_fit_a_build_is_refused(own):
    sent = {**BUILT, "basis": "city", "views": "full"}
    refused = own.post("/v1/maps/west/builds", json=sent)
    assert problem_of(refused) == (422, "invalid-parameters")
    assert "shared basis" in refused.json()["detail"]
    sent = {"encoding": "paper", "basis": "city"}
    assert problem_of(own.post("/v1/maps/west/builds", json=sent)) == (422, "invalid-parameters")
    sent = {**BUILT, "basis": "none"}
    assert problem_of(own.post("/v1/maps/west/builds", json=sent)) == (404, "basis-not-found")
    both = {**BUILT, "basis": "city", "refit": True}
    assert problem_of(own.post("/v1/maps/west/builds", json=both)) == (422, "invalid-request")


def test_a_shared_basis_is_verified_backed_up_and_restored(city, tmp_path):
    data = copy_of(city, tmp_path / "data")
    written = write_backup(data, tmp_path / "backup.tar")
    assert (written.damaged, written.missing) == ((), ())
    restored = restore_backup(tmp_path / "backup.tar", tmp_path / "restored")
    assert restored.files == written.files
    with Store.serving(tmp_path / "restored") as store:
        assert store.bases.read("city").digest == store.bases.get("city").digest
        assert verify(store).findings == ()
        [file] = store.layout.bases.iterdir()
        damage(file, b"nothing")
        [finding] = verify(store).findings
        assert "shared basis" in finding.described
        [finding] = verify(store, repair=True).findings
        assert finding.done.startswith("moved to damaged/")
