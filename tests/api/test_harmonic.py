"""A harmonic map over HTTP: the same routes, and an answer with heading and lateral offset."""

import io
import struct

import numpy as np
import pytest

from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.signature import Packing, pack_signatures
from core.localization.localizer import Localizer
from storage.files.map_file import read_map
from tests.support.campus import IMAGE, NPZ, PACKED, basis_of, localize
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running, upload, wait_for


@pytest.fixture(scope="module", params=["full", "any"])
def views(request):
    return request.param


@pytest.fixture(scope="module")
def client(tmp_path_factory, campus_of, views):
    """A service whose only revision is harmonic."""
    parameters = {
        "segments": 2,
        "encoding": "harmonic",
        "lateral_renderings_m": [-1.5, 0, 1.5],
        "views": views,
        "ranks": [5, 5],
    }
    with running(copy_of(campus_of(**parameters), tmp_path_factory.mktemp("views") / "data")) as it:
        yield it


def as_json(signature):
    return {
        "basis": signature.revision,
        "signatures": [
            {
                "values_real": signature.values.real.tolist(),
                "values_imag": signature.values.imag.tolist(),
                "hidden": list(signature.view.hidden),
            }
        ],
    }


def test_the_revision_reports_its_build_parameters(client, views):
    [revision] = client.get("/v1/maps/campus/revisions").json()["items"]
    assert revision["encoding"] == "harmonic"
    chosen = {name: revision["parameters"][name] for name in ("reducer", "image", "distance")}
    assert chosen == {"reducer": "highest", "image": "height", "distance": "normalised"}
    assert revision["parameters"]["lateral_renderings_m"] == [-1.5, 0.0, 1.5]
    assert revision["parameters"].get("views", "full") == views
    assert revision["parameters"]["verification_images"] == (views == "any")
    images = 60 * 20 * revision["scans"] if views == "any" else 0
    assert revision["parameters"]["verification_bytes"] == images


def test_scan_image_and_signature_agree_with_each_other_and_with_the_method(client, basis, views):
    core = Localizer(read_map(revision_file(client.service.store, "campus", basis.revision)))
    for scan in recording(noise_seed=7, scans=6).scans:
        image = basis.image(scan)
        [signature] = basis.encode(image)
        answers = [
            localize(client, "scan?k=3", content=kitti(scan), headers=KITTI),
            localize(
                client, "image?k=3", content=image.cells.astype("<f4").tobytes(), headers=IMAGE
            ),
            localize(client, "signature?k=3", json=as_json(signature)),
        ]
        assert answers[0] == answers[1]
        if views == "full":
            assert answers[1] == answers[2]
        assert answers[1]["best"]["scan_index"] == answers[2]["best"]["scan_index"]
        expected = core.localize_scan(scan, k=3)
        best = answers[0]["best"]
        assert (best["scan_index"], best["distance"]) == (
            expected.best.scan_index,
            expected.best.distance,
        )
        assert (best["turn_deg"], best["lateral_m"], best["heading_deg"]) == (
            expected.best.relative_yaw_deg,
            expected.best.lateral_m,
            expected.best.heading_deg,
        )
        assert best["estimated_pose"]["yaw_deg"] == best["heading_deg"]
        assert answers[0]["segments_searched"] == [0, 1]
        for packing, size, partial in ((Packing.INT8, 60, 66), (Packing.FLOAT16, 101, 109)):
            body = pack_signatures([signature], packing)
            assert len(body) == (size if signature.view.is_full else partial)
            packed = localize(client, "signature", content=body, headers=PACKED)
            assert abs(packed["best"]["scan_index"] - best["scan_index"]) <= 1


def test_a_query_with_relative_yaw_gets_its_heading(client):
    scan = recording().scans[20]
    rotated = np.stack([scan.points_m[:, 1], -scan.points_m[:, 0], scan.points_m[:, 2]], axis=1)
    body = np.pad(rotated, ((0, 0), (0, 1))).astype("<f4").tobytes()
    best = localize(client, "scan", content=body, headers=KITTI)["best"]
    assert best["scan_index"] == 20
    assert best["lateral_m"] == pytest.approx(0.0, abs=0.1)
    assert best["turn_deg"] == pytest.approx(90.0, abs=0.5)
    expected = (best["pose"]["yaw_deg"] + 90.0 + 180.0) % 360.0 - 180.0
    assert best["heading_deg"] == pytest.approx(expected, abs=0.5)


def test_the_sensor_height_can_be_given_and_need_not_where_scans_are_levelled(client, views):
    scan = recording().scans[20]
    lower = scan.points_m - np.array([0.0, 0.0, 0.6], np.float32)
    body = np.pad(lower, ((0, 0), (0, 1))).astype("<f4").tobytes()
    with_height = localize(client, "scan?sensor_height_m=2.33", content=body, headers=KITTI)["best"]
    without_height = localize(client, "scan", content=body, headers=KITTI)["best"]
    assert with_height["scan_index"] == 20
    if views == "full":
        assert with_height["distance"] < 0.1 * without_height["distance"]
    else:
        assert without_height["scan_index"] == 20
        assert max(with_height["distance"], without_height["distance"]) < 1e-3


@pytest.mark.parametrize("height", ["0", "-1", "100", "nan", "high"])
def test_an_impossible_sensor_height_is_rejected(client, height):
    response = client.post(
        f"/v1/maps/campus/localizations/scan?sensor_height_m={height}",
        content=kitti(recording().scans[0]),
        headers=KITTI,
    )
    assert problem_of(response) == (422, "invalid-request")


def test_the_basis_is_one_small_matrix_in_either_form(client, basis, views):
    assert isinstance(basis, HarmonicBasis)
    assert basis.radial_basis.shape == (20, 5 if views == "full" else 10)
    shown = client.get("/v1/maps/campus/basis").json()
    assert shown["segments"] == []
    assert shown["parameters"]["image"] == "height"
    with np.load(io.BytesIO(client.get("/v1/maps/campus/basis", headers=NPZ).content)) as arrays:
        np.testing.assert_array_equal(arrays["radial_basis"], basis.radial_basis)
        assert str(arrays["revision"]) == basis.revision
    some = client.get("/v1/maps/campus/basis?segment=1").json()
    assert some["radial_basis"] == shown["radial_basis"]


def test_images_of_another_kind_or_grid_are_refused_by_name(client):
    image = np.ones((20, 360), "<f4").tobytes()
    for query, body, problem in (
        ("?image=range", image, "sensor-mismatch"),
        ("", np.ones((30, 361), "<f4").tobytes(), "invalid-image"),
        ("", bytes(4 * 7200), "invalid-image"),
        ("?image=photo", image, "invalid-request"),
    ):
        response = client.post(
            f"/v1/maps/campus/localizations/image{query}", content=body, headers=IMAGE
        )
        assert problem_of(response) == (422, problem)
    assert localize(client, "image?image=height", content=image, headers=IMAGE)


def test_impossible_signatures_are_rejected_by_name(client, basis):
    [signature] = basis.encode(basis.image(recording().scans[0]))
    good = as_json(signature)
    item = good["signatures"][0]
    for signatures, problem in (
        ([item, item], "invalid-signature"),
        ([{"segment": 0, "values": item["values_real"]}], "invalid-signature"),
        ([{**item, "values_real": item["values_real"][:4]}], "invalid-signature"),
        ([{**item, "values_imag": item["values_real"]}], "invalid-signature"),
        ([{"values_real": item["values_real"]}], "invalid-request"),
        ([{**item, "segment": 1}], "invalid-request"),
    ):
        response = client.post(
            "/v1/maps/campus/localizations/signature", json={**good, "signatures": signatures}
        )
        assert problem_of(response) == (422, problem), signatures
    for named, got in (({}, "neither"), ({"revision": good["basis"]}, "both")):
        body = {**{k: v for k, v in good.items() if named or k != "basis"}, **named}
        response = client.post("/v1/maps/campus/localizations/signature", json=body)
        assert problem_of(response) == (422, "invalid-request")
        assert f"wanted basis or revision, got {got}" in response.json()["detail"]
    stale = {**good, "basis": "f" * 64}
    response = client.post("/v1/maps/campus/localizations/signature", json=stale)
    assert problem_of(response) == (409, "stale-signature")


def test_numbers_whose_products_would_overflow_are_refused_and_any_others_are_answered(
    client, basis
):
    [signature] = basis.encode(basis.image(recording().scans[0]))
    body = pack_signatures([signature], Packing.INT8)
    route = "/v1/maps/campus/localizations/signature"
    largest = float(np.abs(signature.values).max())
    for size in (1e30, 9e32, 1.1e33, 1.6e38):
        parts = [signature.values.real, signature.values.imag]
        real, imag = (np.asarray(part * (size / largest), np.float64).tolist() for part in parts)
        item = {**as_json(signature)["signatures"][0], "values_real": real, "values_imag": imag}
        answers = [client.post(route, json={**as_json(signature), "signatures": [item]})]
        if signature.view.is_full:  # the scale of others has two bytes, at another place
            packed = body[:11] + struct.pack("<f", size / 127**2) + body[15:]
            answers.append(client.post(route, content=packed, headers=PACKED))
        for answer in answers:
            if size < 1e33:
                assert answer.json()["best"]["scan_index"] == 0
            else:
                assert problem_of(answer) == (422, "invalid-signature")


def test_a_signature_packed_for_another_encoding_is_refused(client, basis):
    [signature] = basis.encode(basis.image(recording().scans[0]))
    body = bytearray(pack_signatures([signature], Packing.FLOAT16))
    body[0] = 1  # layout 1: the paper's, which reads a segment first
    response = client.post(
        "/v1/maps/campus/localizations/signature",
        content=bytes(body[: 11 + 2 + 50]),
        headers=PACKED,
    )
    assert problem_of(response) == (422, "invalid-signature")


@pytest.mark.parametrize(
    "parameters",
    [
        {"encoding": "harmonic", "ranks": [5, 182]},
        {"encoding": "harmonic", "reducer": "last"},
        {"encoding": "harmonic", "image": "range", "reducer": "highest"},
        {"encoding": "harmonic", "lateral_renderings_m": [1, 0]},
        {"encoding": "paper", "distance": "plain"},
        {"encoding": "paper", "image": "height"},
        {"encoding": "paper", "lateral_renderings_m": [0]},
    ],
)
def test_a_build_whose_options_do_not_go_together_is_refused_at_once(client, parameters):
    response = client.post("/v1/maps/campus/builds", json=parameters)
    assert problem_of(response) == (422, "invalid-parameters")


@pytest.mark.parametrize(
    "parameters",
    [
        {"image": "range", "reducer": "nearest", "distance": "plain"},
        {"image": "height", "reducer": "highest", "ranks": [4, 7]},
    ],
)
def test_every_choice_is_built_and_answers(empty, parameters):
    upload(empty, "monday", recording())
    plain = {"encoding": "harmonic", "lateral_renderings_m": [0]}
    queued = empty.post("/v1/maps/campus/builds", json=plain | parameters)
    assert wait_for(empty, queued.json()["job"])["state"] == "done"
    scan = recording().scans[11]
    assert localize(empty, "scan", content=kitti(scan), headers=KITTI)["best"]["scan_index"] == 11
    basis = basis_of(empty)
    image = basis.image(scan)
    body = image.cells.astype("<f4").tobytes()
    kind = parameters["image"]
    found = localize(empty, f"image?image={kind}", content=body, headers=IMAGE)
    assert found["best"]["scan_index"] == 11
    packed = pack_signatures(basis.encode(image))
    assert localize(empty, "signature", content=packed, headers=PACKED)["best"]["scan_index"] == 11


@pytest.mark.parametrize("views", ["any"], indirect=True)
def test_a_scan_is_located_between_the_scans_of_a_map_of_any_views(client):
    ahead_m, left_m = 0.5, 1.0
    scan = recording().scans[20]
    body = np.pad(scan.points_m - np.array([ahead_m, left_m, 0.0], np.float32), ((0, 0), (0, 1)))
    best = localize(client, "scan", content=body.astype("<f4").tobytes(), headers=KITTI)["best"]
    track = client.post("/v1/maps/campus/tracks").json()["track"]
    observations = f"/v1/maps/campus/tracks/{track}/observations"
    step = client.post(observations, content=body.astype("<f4").tobytes(), headers=KITTI).json()
    assert scan.pose is not None
    yaw = np.radians(scan.pose.yaw_deg)
    x_m = scan.pose.x_m + ahead_m * np.cos(yaw) - left_m * np.sin(yaw)
    y_m = scan.pose.y_m + ahead_m * np.sin(yaw) + left_m * np.cos(yaw)
    for pose in (best["estimated_pose"], step["pose"]):
        assert np.hypot(pose["x_m"] - x_m, pose["y_m"] - y_m) < 0.6
