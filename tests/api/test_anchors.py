"""Maps with a place on the Earth: answers, tracks and graphs have WGS84 beside metres."""

from typing import Any

import numpy as np
import pytest

from app.revisions.geojson_schemas import FeaturesOut
from core.frames.gnss import fit_anchor
from core.mapping.anchor import Anchor
from core.mapping.tensormap import TensorMap
from tests.support.campus import MAP, localize, queue_build
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import problem_of, wait_for

ANCHOR: dict[str, Any] = {
    "latitude_deg": 49.01,
    "longitude_deg": 8.4,
    "altitude_m": 115.0,
    "heading_deg": 30.0,
}
PLAIN = {"segments": 4, "views": "full", "lateral_renderings_m": [0.0]}
"""Of what is built fastest."""


def scan(index=20):
    return kitti(recording(noise_seed=7).scans[index])


def is_at(place, pose):
    names = ("x_m", "y_m", "z_m", "yaw_deg")
    return place == pytest.approx(Anchor(**ANCHOR).pose_wgs84(*(pose[name] for name in names)))


@pytest.fixture
def anchored(own):
    patched = own.patch(MAP, json={"anchor": ANCHOR})
    assert patched.status_code == 200, patched.text
    assert patched.json()["anchor"] == {**ANCHOR, "x_m": 0.0, "y_m": 0.0, "z_m": 0.0}
    return own


def test_answers_of_a_map_with_an_anchor_have_wgs84_and_others_are_as_before(own):
    before = localize(own, "scan", content=scan(), headers=KITTI)
    assert "wgs84" not in before["best"]["pose"]
    own.patch(MAP, json={"anchor": ANCHOR})
    answer = localize(own, "scan", content=scan(), headers=KITTI, params={"k": 2})
    for match in answer["matches"]:
        assert is_at(match["pose"].pop("wgs84"), match["pose"])
    part = localize(own, "scan", content=scan(), headers=KITTI, params={"fields": "best.pose"})
    assert is_at(part["best"]["pose"].pop("wgs84"), part["best"]["pose"])
    everywhere = own.post("/v1/localizations/scan", content=scan(), headers=KITTI).json()
    assert is_at(everywhere["best"]["pose"].pop("wgs84"), everywhere["best"]["pose"])
    own.patch(MAP, json={"anchor": None})
    assert localize(own, "scan", content=scan(), headers=KITTI) == before
    assert own.get(MAP).json()["anchor"] is None


def build_elsewhere(client):
    """Move the drive by 450 m, and return the revision that is built of it, not live."""
    poses = client.get(f"{MAP}/drives/monday/poses").json()["poses"]
    for moved in poses:
        moved["pose"][0] += 450.0
    client.put(f"{MAP}/drives/monday/poses", json={"poses": poses}).raise_for_status()
    return wait_for(client, queue_build(client, **PLAIN))["revision"]


@pytest.mark.parametrize("make_live", [False, True])
def test_that_an_imported_revision_is_in_another_frame_than_the_anchor_is_noted(
    anchored, built, make_live
):
    revision = build_elsewhere(anchored)
    for imported in (built.other, revision):
        path = f"{MAP}/revisions/{imported}"
        file = anchored.get(f"{path}/file").content
        anchored.delete(path)
        answer = anchored.post(
            f"{MAP}/revisions",
            content=file,
            headers={"Content-Type": "application/vnd.tensormap.map+hdf5"},
            params={"make_live": make_live},
        ).json()
        assert answer["live"] == make_live
        if imported == built.other:
            assert answer["notes"] == []
    [note] = answer["notes"]
    assert note.startswith("drive monday is 450.0 m (median) from where it is in ")
    assert note.endswith("set it again" if make_live else "if this revision becomes live")


@pytest.mark.parametrize("damaged", [False, True])
def test_that_a_revision_made_live_is_in_another_frame_than_the_anchor_is_noted(
    anchored, built, damaged
):
    same = anchored.put(f"{MAP}/live", json={"revision": built.other}).json()
    assert (same["live_revision"], same["notes"]) == (built.other, [])
    revision = build_elsewhere(anchored)
    if damaged:  # it can be replaced by another one, though it cannot be compared
        path = revision_file(anchored.service.store, "campus", built.other)
        content = path.read_bytes()
        path.unlink()  # other tests have the same file
        path.write_bytes(content[:-999])
        anchored.service.revisions._loaded.clear()
    put = anchored.put(f"{MAP}/live", json={"revision": revision[:12]}).json()
    assert (put["live_revision"], put["anchor"]["latitude_deg"]) == (revision, 49.01)
    moved_note = (
        f"drive monday is 450.0 m (median) from where it is in revision {built.other[:12]}, which"
        " was live: the map's anchor is of that one's frame, set it again"
    )
    assert put["notes"] == ([] if damaged else [moved_note])
    anchored.patch(MAP, json={"anchor": None})
    back = anchored.put(f"{MAP}/live", json={"revision": built.live}).json()
    assert (back["live_revision"], back["notes"]) == (built.live, [])


def test_tracks_of_a_map_with_an_anchor_have_wgs84(anchored):
    track = anchored.post(f"{MAP}/tracks").headers["Location"]
    for index in range(18, 21):
        step = anchored.post(f"{track}/observations", content=scan(index), headers=KITTI).json()
        assert is_at(step["pose"].pop("wgs84"), step["pose"])
    last = anchored.get(track).json()["last"]
    (listed,) = anchored.get(f"{MAP}/tracks").json()["items"]
    assert listed["place"]["pose"] == last["pose"]
    assert is_at(last["pose"].pop("wgs84"), last["pose"])
    assert last["pose"] == step["pose"]


def test_the_graph_of_a_map_with_an_anchor_has_wgs84_and_is_geojson(anchored):
    nodes = anchored.get(f"{MAP}/topology").json()["nodes"]
    for node in nodes:
        assert is_at(node["pose"].pop("wgs84"), node["pose"])
    answer = anchored.get(f"{MAP}/geojson")
    assert answer.headers["Content-Type"] == "application/geo+json"
    found = answer.json()
    assert found["type"] == "FeatureCollection"

    def of_kind(kind):
        return [of for of in found["features"] if of["properties"]["kind"] == kind]

    (drive,) = of_kind("drive")
    assert drive["properties"]["drive"] == "monday"
    (line,) = drive["geometry"]["coordinates"]
    assert len(line) == 48
    first = recording().pose(0)
    there = Anchor(**ANCHOR).pose_wgs84(first.x_m, first.y_m, first.z_m, first.yaw_deg)
    assert line[0] == pytest.approx(
        [there["longitude_deg"], there["latitude_deg"], there["altitude_m"]]
    )
    assert len(of_kind("edge")) == 3
    assert [feature["properties"]["pose"] for feature in of_kind("node")] == [
        node["pose"] for node in nodes
    ]


def test_geojson_is_as_the_document_describes_it(anchored):
    content = anchored.documented["paths"]["/v1/maps/{map}/geojson"]["get"]["responses"]["200"][
        "content"
    ]
    assert content == {
        "application/geo+json": {"schema": {"$ref": "#/components/schemas/FeaturesOut"}}
    }
    found = anchored.get(f"{MAP}/geojson").json()
    assert FeaturesOut.model_validate(found).model_dump(mode="json") == found


def test_geojson_of_a_map_without_an_anchor_is_refused(client):
    refused = client.get(f"{MAP}/geojson")
    assert problem_of(refused) == (409, "map-not-anchored")


@pytest.mark.parametrize("wrong", [{"latitude_deg": 91}, {"longitude_deg": "8"}, {"other": 1}])
def test_an_anchor_that_is_none_is_refused(client, wrong):
    refused = client.patch(MAP, json={"anchor": {**ANCHOR, **wrong}})
    assert problem_of(refused) == (422, "invalid-request")


def test_an_anchor_does_not_change_the_rest_and_counts_as_a_change(anchored):
    before = anchored.get(MAP)
    after = anchored.patch(
        MAP, json={"description": "Loop"}, headers={"If-Match": before.headers["ETag"]}
    )
    assert after.json()["anchor"] == before.json()["anchor"]
    assert after.json()["version"] == before.json()["version"] + 1


def fixes(every=1, by_s=0.0):
    """Fixes of the recording, some decimetres beside it, the last one first."""
    rng = np.random.default_rng(5)
    at = range(47, -1, -every)
    scans = [recording().scans[index] for index in at]
    places_m = np.array([recording().pose(index).as_tuple()[:3] for index in at])
    places = Anchor(**ANCHOR).wgs84(places_m + rng.normal(scale=0.2, size=places_m.shape))
    names = ("latitude_deg", "longitude_deg", "altitude_m")
    return [
        {"time_s": scan.timestamp_s + by_s, **dict(zip(names, place.tolist(), strict=True))}
        for scan, place in zip(scans, places, strict=True)
    ]


def test_an_anchor_is_fitted_to_the_track_of_a_receiver(own):
    answer = own.post(f"{MAP}/anchor", json={"drive": "monday", "fixes": fixes()})
    assert answer.status_code == 200, answer.text
    found = answer.json()["anchor"]
    fit = found.pop("fitted")
    assert (fit["drive"], fit["agreeing"]) == ("monday", fit["fixes"])
    pose = recording().pose(20)
    there = Anchor(**ANCHOR).pose_wgs84(pose.x_m, pose.y_m, pose.z_m, pose.yaw_deg)
    here = Anchor(**found).pose_wgs84(pose.x_m, pose.y_m, pose.z_m, pose.yaw_deg)
    assert here == pytest.approx(there, abs=1.5)
    assert here["latitude_deg"] == pytest.approx(there["latitude_deg"], abs=1e-5)
    assert own.get(MAP).json()["anchor"] == {**found, "fitted": fit}
    match = localize(own, "scan", content=scan(), headers=KITTI)["best"]
    assert match["pose"]["wgs84"]["latitude_deg"] == pytest.approx(there["latitude_deg"], abs=1e-4)
    last = own.get("/v1/audit", params={"limit": 1000}).json()["items"][-1]
    assert last["action"] == "fit_map_anchor"


def test_an_anchor_is_not_set_beside_another_revision_than_it_was_fitted_to(
    own, built, monkeypatch
):
    def while_another_becomes_live(*given):
        own.put(f"{MAP}/live", json={"revision": built.other}).raise_for_status()
        return fit_anchor(*given)

    monkeypatch.setattr("app.maps.anchor_routes.fit_anchor", while_another_becomes_live)
    refused = own.post(f"{MAP}/anchor", json={"drive": "monday", "fixes": fixes()})
    assert problem_of(refused) == (412, "map-changed")
    assert own.get(MAP).json()["anchor"] is None


def test_how_many_altitudes_an_anchor_has_is_in_how_it_was_fitted(own):
    counted = []
    for with_altitude in (range(48), range(0, 48, 2), ()):
        some = [
            fix if index in with_altitude else {**fix, "altitude_m": None}
            for index, fix in enumerate(fixes())
        ]
        sent = own.post(f"{MAP}/anchor", json={"drive": "monday", "fixes": some})
        anchor = sent.json()["anchor"]
        counted.append(anchor["fitted"]["altitudes"])
        wanted_m = ANCHOR["altitude_m"] if with_altitude else 0.0
        assert anchor["altitude_m"] == pytest.approx(wanted_m, abs=5.0)
    whole, half, none = counted
    assert whole > half > none == 0


@pytest.mark.parametrize(
    ("wanted", "sent"),
    [
        ((404, "unknown-drive"), {"drive": "tuesday", "fixes": fixes()}),
        ((409, "anchor-does-not-fit"), {"drive": "monday", "fixes": fixes(by_s=3600.0)}),
        ((409, "anchor-does-not-fit"), {"drive": "monday", "fixes": fixes(every=30)}),
        ((422, "invalid-request"), {"drive": "monday", "fixes": []}),
    ],
)
def test_a_track_that_does_not_fit_changes_nothing(client, wanted, sent):
    assert problem_of(client.post(f"{MAP}/anchor", json=sent)) == wanted
    assert client.get(MAP).json()["anchor"] is None


def test_a_drive_that_lies_beside_the_others_neither_gets_an_anchor_nor_wgs84(own, monkeypatch):
    aside = property(lambda _: frozenset({"monday"}))
    monkeypatch.setattr(TensorMap, "drives_aside", aside)
    refused = own.post(f"{MAP}/anchor", json={"drive": "monday", "fixes": fixes()})
    assert problem_of(refused) == (409, "anchor-does-not-fit")
    assert "lies beside the others" in refused.json()["detail"]
    own.patch(MAP, json={"anchor": ANCHOR}).raise_for_status()
    answer = localize(own, "scan", content=scan(), headers=KITTI)
    assert "wgs84" not in answer["best"]["pose"]
    everywhere = own.post("/v1/localizations/scan", content=scan(), headers=KITTI).json()
    assert "wgs84" not in everywhere["best"]["pose"]
    track = own.post(f"{MAP}/tracks").headers["Location"]
    own.post(f"{track}/observations", content=scan(), headers=KITTI).raise_for_status()
    assert "wgs84" not in own.get(track).json()["last"]["pose"]
    (listed,) = own.get(f"{MAP}/tracks").json()["items"]
    assert "wgs84" not in listed["place"]["pose"]
    assert own.get(f"{MAP}/geojson").json()["features"] == []
