"""Shared bases: made, downloaded, fitted to several maps, and kept while they are used."""

import io
import json

import numpy as np
import pytest

from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.store import Store
from storage.store.verification import verify
from tests.support.campus import NPZ
from tests.support.city import BUILT, DISTRICTS, build_district
from tests.support.service import copy_of, damage, problem_of, running


@pytest.fixture(scope="module")
def client(city, tmp_path_factory):
    with running(copy_of(city, tmp_path_factory.mktemp("among") / "data")) as client:
        yield client


@pytest.fixture
def own(city, tmp_path):
    with running(copy_of(city, tmp_path / "data")) as client:
        yield client


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
    assert (as_json.headers["Vary"], as_npz.headers["Vary"]) == (
        "Accept, Authorization",
        "Accept, Authorization",
    )
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
