"""Answers to many queries at once, with some fields only, or packed."""

import json
import math
import struct

import pytest

from app.http.answer_forms import PART_TYPE
from app.localization.answers import FIX
from app.localization.query_bodies import BATCH_TYPE
from core.encodings.signature import pack_signatures
from core.localization.localizer import Localizer
from tests.support.campus import MAP, PACKED, basis_of
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running

ONE, BATCH = f"{MAP}/localizations/signature", f"{MAP}/localizations/batch"
MANY = {"Content-Type": BATCH_TYPE}
AS_PACKED = {"Accept": FIX.media_type}


@pytest.fixture(scope="module", params=["harmonic", "paper"])
def client(tmp_path_factory, campus_of, request):
    """A service with a calibrated map."""
    built = campus_of(segments=3, encoding=request.param)
    with running(copy_of(built, tmp_path_factory.mktemp("forms") / "data")) as client:
        yield client


@pytest.fixture(scope="module")
def queries(client):
    """Packed signatures of some scans."""
    basis = basis_of(client)
    scans = recording(noise_seed=7, scans=4).scans
    return [pack_signatures(basis.encode(basis.image(scan))) for scan in scans]


def batch_of(queries):
    return b"".join(len(query).to_bytes(2, "little") + query for query in queries)


def alone(client, query, **params):
    answer = client.post(ONE, content=query, headers=PACKED, params=params)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_batch_is_answered_as_its_queries_are_alone(client, queries):
    answer = client.post(BATCH, content=batch_of(queries), headers=MANY, params={"k": 3})
    assert answer.json()["items"] == [alone(client, query, k=3) for query in queries]


def test_a_batch_of_json_is_answered_likewise(client):
    basis = basis_of(client)
    [signature, *_] = basis.encode(basis.image(recording(noise_seed=7, scans=4).scans[2]))
    values = signature.values
    shape = (
        {"segment": signature.segment, "values": values.tolist()}
        if signature.segment is not None
        else {"values_real": values.real.tolist(), "values_imag": values.imag.tolist()}
    )
    query = {"basis": signature.revision, "signatures": [shape]}
    answer = client.post(BATCH, json={"queries": [query, query]}).json()["items"]
    assert answer == [client.post(ONE, json=query).json()] * 2


@pytest.mark.parametrize("cut", [1, 40, 61])
def test_a_batch_that_ends_early_is_refused_whole(client, queries, cut):
    body = batch_of(queries[:1])[:-cut]
    refused = client.post(BATCH, content=body, headers=MANY)
    assert problem_of(refused) == (422, "invalid-signature")


def test_a_batch_that_ends_in_a_length_is_refused_with_what_came_of_it(client, queries):
    body = batch_of(queries[:2])
    refused = client.post(BATCH, content=body + b"\x05", headers=MANY)
    assert problem_of(refused) == (422, "invalid-signature")
    assert "after 1 byte of the length of query 2, wanted 2" in refused.json()["detail"]


def test_one_wrong_query_refuses_its_batch(client, queries):
    stale = bytearray(queries[1])
    stale[1:9] = bytes(8)
    body = batch_of([queries[0], bytes(stale)])
    refused = client.post(BATCH, content=body, headers=MANY)
    assert problem_of(refused) == (409, "stale-signature")


def test_a_refused_batch_names_the_query_that_is_refused(client, queries):
    stale = bytearray(queries[1])
    stale[1:9] = bytes(8)
    for wrong, kind in ((bytes(stale), "stale-signature"), (b"", "invalid-signature")):
        body = batch_of([*queries[:3], wrong, queries[3]])
        refused = client.post(BATCH, content=body, headers=MANY)
        assert problem_of(refused)[1] == kind
        assert refused.json()["detail"].startswith("query 3: ")
    cut = client.post(BATCH, content=batch_of(queries)[:-1], headers=MANY)
    assert cut.json()["detail"].startswith("query 3 has ")


@pytest.mark.parametrize(
    ("sent", "came"), [(1001, "1001"), (1400, "1400"), (100_001, "more than 100000")]
)
def test_a_batch_with_too_many_queries_is_refused_with_their_number(client, queries, sent, came):
    body = batch_of(queries[:1]) * 1000 + batch_of([b""]) * (sent - 1000)
    refused = client.post(BATCH, content=body, headers=MANY)
    assert problem_of(refused) == (422, "invalid-signature")
    assert refused.json()["detail"] == f"the batch has {came} queries, wanted at most 1000"


def test_a_refused_batch_of_json_names_its_query_likewise(client):
    stale = {"basis": "0" * 64, "signatures": [{"segment": 0, "values": [[1.0]]}]}
    uneven = {**stale, "signatures": [{"segment": 0, "values": [[1.0, 2.0], [1.0]]}]}
    for queries, kind, named in (
        ([stale, uneven], "invalid-signature", "query 1: "),
        ([stale], "stale-signature", "query 0: "),
        ([stale, {**stale, "signatures": []}], "invalid-request", "body/queries/1/signatures: "),
    ):
        refused = client.post(BATCH, json={"queries": queries})
        assert problem_of(refused)[1] == kind
        assert refused.json()["detail"].startswith(named)


def test_a_batch_has_bounds(client, queries):
    many = client.post(BATCH, content=batch_of(queries[:1] * 1001), headers=MANY)
    assert problem_of(many) == (422, "invalid-signature")
    params = {"k": 1000}
    much = client.post(BATCH, content=batch_of(queries[:1] * 11), headers=MANY, params=params)
    assert problem_of(much) == (422, "invalid-parameters")
    assert problem_of(client.post(BATCH, content=b"", headers=MANY)) == (422, "empty-body")
    assert problem_of(client.post(BATCH, json={"queries": []})) == (422, "invalid-request")


def test_an_answer_has_the_fields_that_were_asked_for(client, queries):
    whole = alone(client, queries[1])
    params = {"fields": "localized,best.drive,best.scan_index,matches.distance"}
    part = client.post(ONE, content=queries[1], headers=PACKED, params=params)
    expected = {
        "localized": whole["localized"],
        "best": {name: whole["best"][name] for name in ("drive", "scan_index")},
        "matches": [{"distance": match["distance"]} for match in whole["matches"]],
    }
    assert part.headers["content-type"] == PART_TYPE
    assert json.loads(part.content) == expected
    batch = client.post(BATCH, content=batch_of(queries[1:2]), headers=MANY, params=params)
    assert json.loads(batch.content) == {"items": [expected]}


def test_a_runner_up_is_estimated_only_for_answers_that_have_it(client, queries, monkeypatch):
    whole = alone(client, queries[1])
    wanted = []

    def localize(self, *given, with_runner_up, **others):
        wanted.append(with_runner_up)
        return localize_signatures(self, *given, with_runner_up=with_runner_up, **others)

    localize_signatures = Localizer.localize_signatures
    monkeypatch.setattr(Localizer, "localize_signatures", localize)
    for fields, expected in (
        ("ratio,runner_up.scan_index", {"scan_index": whole["runner_up"]["scan_index"]}),
        ("ratio", None),
    ):
        part = client.post(ONE, content=queries[1], headers=PACKED, params={"fields": fields})
        shown = {"ratio": whole["ratio"]} | ({"runner_up": expected} if expected else {})
        assert json.loads(part.content) == shown
    client.post(ONE, content=queries[1], headers={**PACKED, **AS_PACKED})
    client.post(BATCH, content=batch_of(queries[1:2]), headers=MANY)
    assert wanted == [True, False, False, True]


@pytest.mark.parametrize("fields", ["", "place", "best.place", "localized.best", "best,matches.0"])
def test_an_unknown_field_is_refused_before_the_query_is_read(client, fields):
    refused = client.post(ONE, content=b"nothing", headers=PACKED, params={"fields": fields})
    assert problem_of(refused) == (422, "invalid-request")
    assert refused.json()["errors"][0]["where"] == "query/fields"


def test_a_packed_answer_is_the_answer(client, queries):
    packed = client.post(BATCH, content=batch_of(queries), headers={**MANY, **AS_PACKED})
    assert packed.headers["content-type"] == FIX.media_type
    assert len(packed.content) == FIX.bytes * len(queries)
    assert FIX.bytes <= 64
    for number, query in enumerate(queries):
        content = packed.content[number * FIX.bytes : (number + 1) * FIX.bytes]
        one = client.post(ONE, content=query, headers={**PACKED, **AS_PACKED})
        assert one.content == content
        _require_same(struct.unpack("<BBHHI8s5f3e2d", content), alone(client, query))


def _require_same(values, answer):
    layout, flags, segment, drive, scan, revision, *numbers = values
    best = answer["best"]
    pose = best["estimated_pose"] or best["pose"]
    assert layout == 1
    assert bool(flags & 1) == answer["localized"]
    assert bool(flags & 2) == (answer["revision"] == answer["live_revision"])
    assert bool(flags & 4) == (best["estimated_pose"] is not None)
    reasons = [None, "unknown_place", "ambiguous", "too_few_returns", "outside_prior"]
    assert reasons[flags >> 4] == answer["reason"]
    assert (segment, drive, scan) == (best["segment"], 0, best["scan_index"])
    assert answer["revision"].startswith(revision.hex())
    expected = [
        answer["probability"],
        best["distance"],
        answer["ratio"],
        pose["z_m"],
        pose["yaw_deg"],
        answer["along_std_m"],
        answer["lateral_std_m"],
        answer["heading_std_deg"],
        pose["x_m"],
        pose["y_m"],
    ]
    for name, value, number in zip(range(10), expected, numbers, strict=True):
        if value is None:
            assert math.isnan(number), name
        else:
            assert number == pytest.approx(value, rel=1e-3, abs=1e-4), name


def test_a_scan_is_answered_in_these_forms_too(client):
    body = kitti(recording(noise_seed=7, scans=4).scans[1])
    path, kind = f"{MAP}/localizations/scan", KITTI
    packed = client.post(path, content=body, headers={**kind, **AS_PACKED})
    assert len(packed.content) == FIX.bytes
    part = client.post(path, content=body, headers=kind, params={"fields": "best.scan_index"})
    assert json.loads(part.content) == {"best": {"scan_index": 1}}


@pytest.mark.parametrize("kind", ["scan", "image", "signature", "batch"])
def test_fields_of_a_packed_answer_are_refused_before_the_query_is_read(client, kind):
    # It has the same fields always, and who gets others than asked for reads them wrongly.
    asked = {"params": {"fields": "best.scan_index"}, "headers": {**PACKED, **AS_PACKED}}
    refused = client.post(f"{MAP}/localizations/{kind}", content=b"nothing", **asked)
    assert problem_of(refused) == (422, "invalid-request")
    assert "fields" in refused.json()["detail"]
    assert FIX.media_type in refused.json()["detail"]


def test_an_answer_of_all_maps_is_json_of_all_fields_whatever_is_accepted(client):
    body = kitti(recording(noise_seed=7, scans=4).scans[1])
    packed = client.post("/v1/localizations/scan", content=body, headers={**KITTI, **AS_PACKED})
    assert packed.headers["content-type"] == "application/json"
    assert packed.json()["map"] == "campus"


def test_an_answer_of_all_maps_has_the_fields_that_were_asked_for(client):
    path, body = "/v1/localizations/scan", kitti(recording(noise_seed=7, scans=4).scans[1])
    params = {"fields": "map,localized,best.scan_index"}
    part = client.post(path, content=body, headers=KITTI, params=params)
    assert part.headers["content-type"] == PART_TYPE
    whole = client.post(path, content=body, headers=KITTI).json()
    assert json.loads(part.content) == {
        "map": "campus",
        "localized": whole["localized"],
        "best": {"scan_index": 1},
    }
    unknown = client.post(path, content=body, headers=KITTI, params={"fields": "best.place"})
    assert problem_of(unknown) == (422, "invalid-request")
