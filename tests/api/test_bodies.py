"""Bodies that are no scan: each has its own problem, and nothing stored changes."""

import numpy as np
import pytest

from tests.support.catalog_rows import stored_scans
from tests.support.recording import KITTI, NPY, kitti, npy, recording, upload_scan
from tests.support.service import problem_of, running, whole_store

SCAN = recording(scans=1).scans[0]
POINTS = SCAN.points_m[:200].astype(np.float64)
UNKNOWN = {"Content-Type": "application/x-rosbag"}
POSES = b"1 0 0 0 0 1 0 0 0 0 1 0\n" * 9
DOUBLES = np.random.default_rng(0).normal(scale=20.0, size=(400, 4))

BAD = {
    "empty": (b"", KITTI, 422, "empty-body"),
    "truncated KITTI": (kitti(SCAN)[:-3], KITTI, 422, "truncated-scan"),
    "truncated npy": (npy(POINTS)[:-3], NPY, 422, "truncated-scan"),
    "all NaN": (npy(np.full((500, 3), np.nan)), NPY, 422, "too-few-returns"),
    "all zero": (bytes(16 * 500), KITTI, 422, "too-few-returns"),
    "integers": (npy(np.ones((500, 3), np.int32)), NPY, 422, "wrong-dtype"),
    "doubles as KITTI": (DOUBLES.tobytes(), KITTI, 422, "wrong-dtype"),
    "two columns": (npy(np.ones((500, 2))), NPY, 422, "malformed-scan"),
    "text as npy": (b"x y z\n1 2 3\n", NPY, 422, "malformed-scan"),
    "a type without a reader": (b"#ROSBAG V2.0", UNKNOWN, 415, "unknown-format"),
    "no type and no magic": (b"\x00" * 64, {}, 415, "unknown-format"),
    "a packing that is unknown": (
        kitti(SCAN),
        {**KITTI, "Content-Encoding": "br"},
        415,
        "unsupported-body",
    ),
}


@pytest.mark.parametrize(("body", "headers", "status", "problem"), BAD.values(), ids=BAD)
def test_a_body_without_a_scan_is_refused_by_name_and_changes_nothing(
    client, body, headers, status, problem
):
    before = whole_store(client)
    for method, path in (
        ("PUT", "/v1/maps/campus/drives/monday/scans/900"),
        ("PUT", "/v1/maps/campus/drives/new/scans/0"),
        ("POST", "/v1/maps/campus/localizations/scan"),
    ):
        refused = client.request(method, path, content=body, headers=headers)
        assert problem_of(refused) == (status, problem)
    assert whole_store(client) == before


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A service that reads bodies up to 2,000 bytes."""
    with running(tmp_path_factory.mktemp("small"), max_body_bytes=2_000) as client:
        client.post("/v1/maps", json={"map": "campus"})
        yield client


def chunks(count):
    return (bytes(100) for _ in range(count))


@pytest.mark.parametrize("path", ["drives/d/scans/0", "drives/d/poses"])
@pytest.mark.parametrize("body", [bytes(2_001), chunks], ids=["declared", "chunked"])
def test_a_body_beyond_the_limit_is_refused(small, path, body):
    before = whole_store(small)
    content = body(21) if callable(body) else body
    kind = {"Content-Type": "application/json"} if path.endswith("poses") else KITTI
    refused = small.put(f"/v1/maps/campus/{path}", content=content, headers=kind)
    assert problem_of(refused) == (413, "body-too-large")
    assert "2000" in refused.json()["detail"]
    assert whole_store(small) == before


def test_json_is_refused_far_below_the_length_of_a_scan(own):
    before = whole_store(own)
    body = b'{"poses": [' + b" " * 5_000_000
    refused = own.put(
        "/v1/maps/campus/drives/d/poses",
        content=body,
        headers={"Content-Type": "application/json"},
    )
    assert problem_of(refused) == (413, "body-too-large")
    assert whole_store(own) == before


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("builds", {"drives": [0] * 100_000}),
        ("builds", {"drives": ["a"] * 1_001}),
        (
            "localizations/signature",
            {"revision": "0f" * 32, "signatures": [{"segment": 0, "values": [""] * 100_000}]},
        ),
        (
            "localizations/signature",
            {"revision": "0f" * 32, "signatures": [{"segment": 0, "values": [[0.0] * 256]}]},
        ),
    ],
)
def test_of_a_list_that_is_wrong_throughout_one_error_is_reported(own, path, body):
    refused = own.post(f"/v1/maps/campus/{path}", json=body)
    assert problem_of(refused) == (422, "invalid-request")
    assert len(refused.json()["errors"]) == 1


def test_a_body_at_the_limit_is_read(small):
    refused = small.put("/v1/maps/campus/drives/d/scans/0", content=chunks(20), headers=KITTI)
    assert problem_of(refused) == (422, "too-few-returns")  # they are zeros


def test_returns_that_are_none_are_left_out_and_counted(own):
    points = POINTS.copy()
    points[:30] = np.nan
    points[30:50] = 0.0
    points[50, 1] = np.inf
    stored = own.put("/v1/maps/campus/drives/rain/scans/0", content=npy(points), headers=NPY)
    assert stored.status_code == 201
    assert (stored.json()["returns"], stored.json()["dropped_returns"]) == (149, 51)


def test_a_scan_put_twice_is_stored_once(own):
    first = upload_scan(own, "campus", "again", 3, SCAN)
    before = whole_store(own)
    second = upload_scan(own, "campus", "again", 3, SCAN)
    as_npy = own.put(
        "/v1/maps/campus/drives/again/scans/3", content=npy(SCAN.points_m), headers=NPY
    )
    assert [r.status_code for r in (first, second, as_npy)] == [201, 200, 200]
    assert first.json() == second.json() == as_npy.json()
    assert "Location" not in second.headers
    assert whole_store(own) == before


def test_another_scan_at_the_same_index_is_refused_and_the_first_stays(own):
    upload_scan(own, "campus", "again", 3, SCAN)
    before = whole_store(own)
    refused = upload_scan(own, "campus", "again", 3, recording().scans[1])
    assert problem_of(refused) == (409, "scan-conflict")
    assert whole_store(own) == before
    stored = own.service.store.drives.read_scan("campus", "again", 3)
    assert stored.points_m.tobytes() == SCAN.points_m.tobytes()


def test_a_closed_drive_takes_no_new_scan_and_keeps_the_old_ones(own):
    closed = own.patch("/v1/maps/campus/drives/monday", json={"closed": True})
    assert closed.json()["closed"] is True
    refused = upload_scan(own, "campus", "monday", 900, SCAN)
    assert problem_of(refused) == (409, "drive-closed")
    assert upload_scan(own, "campus", "monday", 0, recording().scans[0]).status_code == 200
    reopened = own.patch("/v1/maps/campus/drives/monday", json={"closed": False})
    assert problem_of(reopened) == (422, "invalid-request")


@pytest.mark.parametrize(
    "pose",
    [
        "",
        "1,2,3",
        "0,0,0,0,0,0,2",
        "0,0,0,0,0,0,nan",
        "a,0,0,0,0,0,1",
        "1e999,0,0,0,0,0,1",
        "1_0,0,0,0,0,0,1",
        "\u0661,0,0,0,0,0,1",  # an Arabic digit
    ],
)
def test_an_invalid_pose_is_rejected(client, pose):
    refused = upload_scan(client, "campus", "monday", 900, SCAN, params={"pose": pose})
    assert problem_of(refused) == (422, "invalid-pose")


@pytest.mark.parametrize(
    ("poses", "problem"),
    [
        ([], (422, "invalid-request")),
        ([{"scan": 0, "pose": [0.0] * 6}], (422, "invalid-request")),
        ([{"scan": 0, "pose": [0.0] * 7}], (422, "invalid-pose")),
        ([{"scan": 1}, {"scan": 1}], (422, "invalid-pose")),
        ([{"scan": 10**30, "pose": None}], (422, "invalid-request")),
        ([{"scan": 2**53 - 1, "pose": None}], (404, "scan-not-found")),
        ([{"scan": 0, "pose": None}, {"scan": 900, "pose": None}], (404, "scan-not-found")),
    ],
)
def test_poses_that_cannot_be_set_change_nothing(client, poses, problem):
    before = stored_scans(client.service.store, "campus", "monday")
    refused = client.put("/v1/maps/campus/drives/monday/poses", json={"poses": poses})
    assert problem_of(refused) == problem
    assert stored_scans(client.service.store, "campus", "monday") == before


def test_a_thousand_things_that_are_wrong_are_not_all_repeated(client):
    poses = [{"scan": -1, **{f"{number}{'x' * 5_000}": 1 for number in range(100)}}]
    refused = client.put("/v1/maps/campus/drives/monday/poses", json={"poses": poses})
    assert len(refused.json()["errors"]) == 20
    assert "81 more" in refused.json()["detail"]
    assert len(refused.content) < 20_000


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (b"", (422, "empty-body")),
        (b"\x00" * 8, (422, "invalid-image")),
        (np.full((30, 361), np.nan, "<f4").tobytes(), (422, "invalid-image")),
        (np.full((30, 361), -1, "<f4").tobytes(), (422, "invalid-image")),
        (np.zeros((30, 361), "<f4").tobytes(), (422, "invalid-image")),
    ],
)
def test_an_invalid_image_is_rejected(client, body, why):
    headers = {"Content-Type": "application/vnd.tensormap.image"}
    refused = client.post("/v1/maps/campus/localizations/image", content=body, headers=headers)
    assert problem_of(refused) == why


@pytest.mark.parametrize("kind", ["image", "signature"])
def test_a_query_of_another_type_is_rejected_with_the_expected_one(client, kind):
    refused = client.post(f"/v1/maps/campus/localizations/{kind}", content=b"x", headers=UNKNOWN)
    assert problem_of(refused) == (415, "unsupported-body")
    assert "application/vnd.tensormap" in refused.json()["detail"]


@pytest.mark.parametrize(
    "headers", [{}, {"Content-Type": "text/plain"}, {"Content-Type": "application/jsonl"}]
)
def test_json_without_its_media_type_is_rejected_as_from_a_foreign_page(client, headers):
    refused = client.post("/v1/maps", content=b'{"map": "forged"}', headers=headers)
    assert problem_of(refused) == (415, "unsupported-body")
    assert "application/json" in refused.json()["detail"]


@pytest.mark.parametrize("body", [b"", b"{", b"\xff", b"[" * 100_000, b"3"])
def test_json_that_cannot_be_read_is_refused(client, body):
    headers = {"Content-Type": "application/json"}
    refused = client.post("/v1/maps", content=body, headers=headers)
    assert problem_of(refused) == (422, "invalid-request")


@pytest.mark.parametrize(
    ("method", "path", "body", "problem"),
    [
        ("POST", "", '{"map": "?"}', "invalid-slug"),
        ("POST", "", '{"map": "x", "description": "?"}', "invalid-request"),
        ("PUT", "/campus/live", '{"revision": "????????????"}', "invalid-request"),
        ("POST", "/campus/builds", '{"drives": ["?"]}', "invalid-request"),
        ("POST", "/campus/builds", '{"sensor": "?"}', "invalid-parameters"),
    ],
)
def test_half_a_surrogate_pair_is_rejected(client, method, path, body, problem):
    half = body.replace("?", "\\ud800")
    headers = {"Content-Type": "application/json"}
    refused = client.request(method, f"/v1/maps{path}", content=half, headers=headers)
    assert problem_of(refused) == (422, problem)


@pytest.mark.parametrize(
    ("method", "path", "problem"),
    [
        ("PUT", "drives/monday/scans/7", "unknown-format"),
        ("POST", "drives/monday/scans", "unsupported-body"),
        ("PUT", "drives/monday/poses", "unsupported-body"),
        ("POST", "builds", "unsupported-body"),
        ("POST", "localizations/image", "unsupported-body"),
        ("POST", "revisions", "unsupported-body"),
    ],
)
def test_a_body_sent_as_a_form_is_refused_with_how_curl_sends_a_file(client, method, path, problem):
    form = {"Content-Type": "application/x-www-form-urlencoded; charset=UTF-8"}
    parts = {"Content-Type": "multipart/form-data; boundary=------------------------0"}
    for headers, hinted in ((form, True), (parts, True), (UNKNOWN, False)):
        refused = client.request(
            method, f"/v1/maps/campus/{path}", content=b"sent", headers=headers
        )
        assert problem_of(refused)[1] == problem
        assert ("--data-binary" in refused.json()["detail"]) is hinted


def as_curl_sends(body):
    """Return a file as `curl -d @FILE` sends it."""
    return body.translate(None, b"\r\n\0")


@pytest.mark.parametrize(
    ("method", "path", "kind", "body"),
    [
        ("PUT", "drives/monday/scans/7", KITTI["Content-Type"], kitti(SCAN)),
        ("POST", "localizations/scan", NPY["Content-Type"], npy(POINTS)),
        ("POST", "localizations/image", "application/vnd.tensormap.image", bytes(7) + b"image"),
        ("PUT", "drives/monday/poses", "application/vnd.tensormap.poses.kitti", POSES),
        ("POST", "drives/monday/scans", "application/x-tar", b"x" * 600 + bytes(600)),
        ("POST", "localizations/signature", "application/vnd.tensormap.signature", b"TM\0\0sig"),
    ],
    ids=["KITTI", "npy", "image", "poses", "tar", "signature"],
)
def test_a_file_that_curl_has_changed_is_refused_with_how_to_send_it(
    client, method, path, kind, body
):
    for agent, hinted in (("curl/8.5.0", True), ("vehicle/1", False)):
        refused = client.request(
            method,
            f"/v1/maps/campus/{path}",
            content=as_curl_sends(body),
            headers={"Content-Type": kind, "User-Agent": agent},
        )
        assert refused.status_code == 422
        assert ("--data-binary" in refused.json()["detail"]) is hinted


def test_a_file_that_curl_has_not_changed_is_refused_without_how_to_send_it(client):
    """One with a line break or a zero byte was not sent by `curl -d`."""
    for body in (npy(POINTS), b"\r", b"\n", b"\0"):
        refused = client.post(
            "/v1/maps/campus/localizations/scan",
            content=body,
            headers={**KITTI, "User-Agent": "curl/8.5.0"},
        )
        assert refused.status_code == 422
        assert "curl" not in refused.json()["detail"]


def test_json_that_curl_sends_needs_no_other_way_to_send_it(client):
    refused = client.post(
        "/v1/maps/campus/localizations/signature",
        json={"signatures": []},
        headers={"User-Agent": "curl/8.5.0"},
    )
    assert refused.status_code == 422
    assert "--data-binary" not in refused.json()["detail"]


def test_a_request_that_takes_no_body_refuses_one_and_does_nothing(own):
    assert own.delete("/v1/maps/campus/drives/monday").status_code == 204
    [entry] = own.get("/v1/recycle-bin").json()["items"]
    restore = f"/v1/recycle-bin/{entry['entry']}/restore"
    before = own.get("/v1/maps/campus/tracks").json()
    for path in (restore, "/v1/maps/campus/tracks"):
        for body in ({"json": {"name": "tuesday"}}, {"content": chunks(2)}):
            refused = own.post(path, **body)
            assert problem_of(refused) == (422, "invalid-request")
            assert "takes no body" in refused.json()["detail"]
    assert own.get("/v1/recycle-bin").json()["items"] == [entry]
    assert own.get("/v1/maps/campus/tracks").json() == before
    assert own.post(restore, content=iter([b""])).json()["drive"] == "monday"
    for nothing in (b"", b"{}", iter([b"{", b"}"])):
        assert own.post("/v1/maps/campus/tracks", content=nothing).status_code == 201
