"""From an empty service to a place: what a mapping and a fleet vehicle do, in order."""

import io

import numpy as np
import pytest

from app.revisions.schemas import BasisOut
from core.encodings.paper.basis import PaperBasis
from core.encodings.signature import pack_signatures
from core.localization.localizer import Localizer
from core.parameters import MapParameters
from storage.files.map_file import read_map
from tests.support.campus import IMAGE, NPZ, PACKED, basis_of, localize
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, NPY, kitti, npy, recording
from tests.support.service import pose_text, problem_of, wait_for


def as_json(signatures):
    return {
        "basis": signatures[0].revision,
        "signatures": [{"segment": s.segment, "values": s.values.tolist()} for s in signatures],
    }


def test_a_map_is_made_filled_built_and_answers_where_a_scan_was_taken(empty):
    made = empty.post("/v1/maps", json={"map": "harbour", "description": "quay"})
    assert (made.status_code, made.headers["Location"]) == (201, "/v1/maps/harbour")
    drive = recording()
    for index, scan in enumerate(drive.scans):
        params = {"pose": pose_text(drive.pose(index))} if index < 10 else {}
        put = empty.put(
            f"/v1/maps/harbour/drives/monday/scans/{index}",
            content=npy(scan.points_m),
            headers=NPY,
            params=params,
        )
        assert put.status_code == 201
        assert put.headers["Location"] == f"/v1/maps/harbour/drives/monday/scans/{index}"
        assert put.json()["has_pose"] is (index < 10)
    rest = [
        {"scan": i, "pose": list(drive.pose(i).as_tuple()), "timestamp_s": i / 10}
        for i in range(10, len(drive))
    ]
    poses = empty.put("/v1/maps/harbour/drives/monday/poses", json={"poses": rest})
    assert poses.json()["present"] == [{"first": 0, "last": len(drive) - 1}]

    queued = empty.post("/v1/maps/harbour/builds", json={"segments": 2})
    assert queued.status_code == 202
    job = wait_for(empty, queued.headers["Location"].removeprefix("/v1/jobs/"))
    assert (job["state"], job["error"]) == ("done", None)
    assert job["done"] == job["total"] > 0
    assert empty.get("/v1/maps/harbour").json()["live_revision"] == job["revision"]

    scan = drive.scans[20]
    found = empty.post("/v1/maps/harbour/localizations/scan", content=kitti(scan), headers=KITTI)
    best = found.json()["best"]
    assert (best["drive"], best["scan_index"], best["timestamp_s"]) == ("monday", 20, 2.0)
    assert best["distance"] == pytest.approx(0.0, abs=1e-2)
    assert best["pose"]["x_m"] == drive.pose(20).x_m


def test_scan_image_and_signature_of_one_place_agree_with_each_other_and_with_the_method(
    client, built
):
    basis = basis_of(client)
    core = Localizer(read_map(revision_file(client.service.store, "campus", built.live)))
    for scan in recording(noise_seed=7, scans=6).scans:
        image = basis.image(scan)
        signatures = basis.encode(image)
        answers = [
            localize(client, "scan?k=3", content=kitti(scan), headers=KITTI),
            localize(
                client, "image?k=3", content=image.cells.astype("<f4").tobytes(), headers=IMAGE
            ),
            localize(client, "signature?k=3", json=as_json(signatures)),
        ]
        assert answers[0] == answers[1] == answers[2]
        expected = core.localize_scan(scan, k=3)
        assert [m["scan_index"] for m in answers[0]["matches"]] == [
            m.scan_index for m in expected.matches
        ]
        assert answers[0]["best"]["distance"] == expected.best.distance
        assert answers[0]["ratio"] == expected.ratio
        assert answers[0]["revision"] == answers[0]["live_revision"] == built.live
        assert answers[0]["segments_searched"] == [0, 1, 2]

        body = pack_signatures(signatures)
        assert len(body) == 11 + 3 * (2 + 2 * 25)
        packed = localize(client, "signature", content=body, headers=PACKED)
        assert packed["best"]["scan_index"] == expected.best.scan_index  # float16 moved it nowhere


def test_one_signature_searches_its_own_segment_only(client):
    basis = BasisOut.model_validate(client.get("/v1/maps/campus/basis?segment=1").json()).to_core()
    assert isinstance(basis, PaperBasis)
    assert basis.segments.tolist() == [1]
    [signature] = basis.encode(basis.image(recording().scans[20]))
    found = localize(client, "signature", json=as_json([signature]))
    assert (found["segments_searched"], found["best"]["scan_index"]) == ([1], 20)


def test_the_basis_is_the_same_as_json_and_as_npz(client):
    whole = client.get("/v1/maps/campus/basis")
    from_json = BasisOut.model_validate(whole.json()).to_core()
    as_npz = client.get("/v1/maps/campus/basis", headers=NPZ)
    assert as_npz.headers["ETag"] != whole.headers["ETag"]
    with np.load(io.BytesIO(as_npz.content), allow_pickle=False) as arrays:
        from_npz = PaperBasis(
            str(arrays["revision"]),
            str(arrays["basis"]),
            MapParameters.from_attributes(whole.json()["parameters"]),
            arrays["segments"],
            arrays["elevation_basis"],
            arrays["azimuth_basis"],
        )
    scan = recording().scans[3]
    for one, two in zip(
        from_json.encode(from_json.image(scan)), from_npz.encode(from_npz.image(scan)), strict=True
    ):
        assert one.values.tobytes() == two.values.tobytes()
        assert (one.segment, one.revision) == (two.segment, two.revision)


@pytest.mark.parametrize("headers", [{}, NPZ], ids=["json", "npz"])
def test_a_basis_that_the_vehicle_has_is_not_sent_again(client, headers):
    first = client.get("/v1/maps/campus/basis", headers=headers)
    etag = first.headers["ETag"]
    for held in (etag, etag.removeprefix("W/"), f'"another", {etag}', "*"):
        again = client.get("/v1/maps/campus/basis", headers={**headers, "If-None-Match": held})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["ETag"] == etag
    other = client.get("/v1/maps/campus/basis", headers={**headers, "If-None-Match": '"another"'})
    assert other.status_code == 200


def test_some_segments_are_never_taken_for_the_whole_basis(client):
    whole = client.get("/v1/maps/campus/basis").headers["ETag"]
    some = client.get(
        "/v1/maps/campus/basis?segment=2&segment=0&segment=2", headers={"If-None-Match": whole}
    )
    assert [item["segment"] for item in some.json()["segments"]] == [0, 2]
    assert "ETag" not in some.headers


@pytest.mark.parametrize("segment", ["3", "2147483647"])
def test_a_segment_that_the_map_lacks_is_refused(client, segment):
    response = client.get(f"/v1/maps/campus/basis?segment={segment}")
    assert problem_of(response) == (422, "unknown-segment")


@pytest.mark.parametrize("segment", ["-1", "99999999999999999999999999", "one"])
def test_an_invalid_segment_is_rejected(client, segment):
    response = client.get(f"/v1/maps/campus/basis?segment={segment}")
    assert problem_of(response) == (422, "invalid-request")


def test_the_topology_is_the_graph_of_the_segments(client, built):
    graph = client.get("/v1/maps/campus/topology").json()
    assert graph["revision"] == built.live
    assert [edge["segment"] for edge in graph["edges"]] == [0, 1, 2]
    assert sum(edge["scans"] for edge in graph["edges"]) == len(recording()) - 1
    assert all(edge["length_m"] > 0 and 0 < edge["relative_error"] < 1 for edge in graph["edges"])
    assert {node for edge in graph["edges"] for node in edge["nodes"]} == set(
        range(len(graph["nodes"]))
    )
    other = client.get("/v1/maps/campus/topology", params={"revision": built.other}).json()
    assert len(other["edges"]) == 2


def test_a_downloaded_revision_is_the_map_of_that_digest(client, built, tmp_path):
    response = client.get(f"/v1/maps/campus/revisions/{built.live[:12]}/file")
    assert response.headers["ETag"].startswith(f'"{built.live}-')
    path = tmp_path / "downloaded.h5"
    path.write_bytes(response.content)
    assert read_map(path).revision == built.live


def test_a_scan_comes_back_bit_for_bit(client):
    response = client.get("/v1/maps/campus/drives/monday/scans/5")
    points = np.load(io.BytesIO(response.content), allow_pickle=False)
    assert points.dtype == np.float32
    assert points.tobytes() == recording().scans[5].points_m.tobytes()


def test_a_time_alone_leaves_the_pose_and_a_null_forgets_it(own):
    poses = "/v1/maps/campus/drives/monday/poses"
    read = own.service.store.drives.read_scan
    before = read("campus", "monday", 4)
    own.put(poses, json={"poses": [{"scan": 4, "timestamp_s": 99.5}]})
    timed = read("campus", "monday", 4)
    assert (timed.timestamp_s, timed.pose) == (99.5, before.pose)
    own.put(poses, json={"poses": [{"scan": 4, "pose": None}]})
    forgotten = read("campus", "monday", 4)
    assert (forgotten.timestamp_s, forgotten.pose) == (99.5, None)


def test_a_query_of_another_sensor_is_refused(client):
    for kind, headers in (("scan", KITTI), ("image", IMAGE)):
        response = client.post(
            f"/v1/maps/campus/localizations/{kind}?sensor=vlp-16", content=b"", headers=headers
        )
        assert problem_of(response) == (422, "sensor-mismatch")
