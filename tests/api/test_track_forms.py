"""Answers of a track with some fields only, or packed: over HTTP and over a stream."""

import json
import math
import struct

import pytest
from starlette.testclient import WebSocketDenialResponse

from app.http.answer_forms import PART_TYPE
from app.tracking.answers import STEP, STREAM_PROTOCOL
from core.encodings.signature import pack_signatures
from tests.support.campus import PACKED, basis_of
from tests.support.recording import recording
from tests.support.service import copy_of, problem_of, running, wait_for
from tests.support.tracks import new_track, open_stream

AS_PACKED = {"Accept": STEP.media_type}
REASONS = (None, "converging", "unknown_place", "ambiguous")
NO_SEQUENCE = 2**64 - 1


@pytest.fixture(scope="module", params=["paper", "harmonic"])
def client(tmp_path_factory, campus_of, request):
    """A service with a map."""
    built = campus_of(segments=3, encoding=request.param)
    with running(copy_of(built, tmp_path_factory.mktemp("forms") / "data")) as client:
        yield client


@pytest.fixture(scope="module")
def queries(client):
    """Packed signatures of a second drive along the map, there and back."""
    basis = basis_of(client)
    scans = recording(noise_seed=7).scans
    return [pack_signatures(basis.encode(basis.image(scan))) for scan in [*scans, *scans[::-1]]]


def numbered(query, sequence, timestamp_s):
    """The query as an observation of a stream."""
    return struct.pack("<BQdd", 64, sequence, timestamp_s, math.nan) + query


def require_same(content, answer):
    """Require that a packed answer says what the JSON of the same observation does."""
    assert len(content) == STEP.bytes <= 64
    layout, flags, segment, drive, scan, sequence, *numbers = struct.unpack(
        "<BBHHIQ5f5e2d", content
    )
    assert layout == 1
    assert bool(flags & 1) == answer["localized"]
    assert bool(flags & 2) == (answer["revision"] == answer["live_revision"])
    assert bool(flags & 4) == answer["segment_sure"]
    assert bool(flags & 8) == answer["standing"]
    assert {0: None, 16: "along", 32: "against"}[flags & 48] == answer["direction"]
    assert REASONS[flags >> 6] == answer["reason"]
    assert (segment, drive, scan) == (answer["segment"], 0, answer["scan_index"])
    assert sequence == (NO_SEQUENCE if answer["sequence"] is None else answer["sequence"])
    names = [
        "probability",
        "distance",
        "fraction",
        "z_m",
        "yaw_deg",
        "segment_probability",
        "along_sigma_m",
        "along_sigma_scans",
        "lateral_m",
        "turn_deg",
        "x_m",
        "y_m",
    ]
    known = answer | (answer["pose"] or {})
    for name, number in zip(names, numbers, strict=True):
        if known[name] is None:
            assert math.isnan(number), name
        else:
            assert number == pytest.approx(known[name], rel=1e-3, abs=1e-4), name


def test_a_packed_answer_is_the_answer(client, queries):
    whole, packed = new_track(client), new_track(client)
    seen = set()
    for index, query in enumerate(queries):
        params = {} if index == 0 else {"sequence": index, "timestamp_s": 0.1 * index}
        asked = {"content": query, "params": params}
        answer = client.post(f"{whole}/observations", headers=PACKED, **asked).json()
        found = client.post(f"{packed}/observations", headers={**PACKED, **AS_PACKED}, **asked)
        assert found.headers["content-type"] == STEP.media_type
        require_same(found.content, answer)
        seen |= {answer["direction"], answer["reason"]}
    assert seen >= {"along", "against", "converging", None}  # the flags were not all alike


def test_a_packed_answer_says_whether_the_track_is_in_the_live_revision(client, queries):
    track = new_track(client)
    asked = {"content": queries[3], "headers": {**PACKED, **AS_PACKED}}
    live = client.get("/v1/maps/campus").json()["live_revision"]
    wanted = {"segments": 2, "make_live": True, "force": True}
    queued = client.post("/v1/maps/campus/builds", json=wanted)
    assert wait_for(client, queued.json()["job"])["state"] == "done"
    assert not client.post(f"{track}/observations", **asked).content[1] & 2
    client.put("/v1/maps/campus/live", json={"revision": live}).raise_for_status()
    assert client.post(f"{track}/observations", **asked).content[1] & 2


def test_a_stream_answers_packed_where_the_client_offers_it_and_problems_stay_text(client, queries):
    whole, packed = new_track(client), new_track(client)
    offered = {"subprotocols": ["other", STREAM_PROTOCOL]}
    with (
        open_stream(client, f"{whole}/stream") as as_json,
        open_stream(client, f"{packed}/stream", **offered) as as_packed,
    ):
        assert as_json.accepted_subprotocol is None
        assert as_packed.accepted_subprotocol == STREAM_PROTOCOL
        for index, query in enumerate(queries[:8]):
            for stream in (as_json, as_packed):
                stream.send_bytes(numbered(query, index, 0.1 * index))
            require_same(as_packed.receive_bytes(), as_json.receive_json())
        as_packed.send_bytes(numbered(queries[8], 3, 9.0))
        assert as_packed.receive_json()["type"] == "/problems/stale-observation"


def test_an_answer_has_the_fields_that_were_asked_for(client, queries):
    whole, part, streamed = (new_track(client) for _ in range(3))
    answer = client.post(f"{whole}/observations", content=queries[0], headers=PACKED).json()
    expected = {"localized": answer["localized"], "pose": {"x_m": answer["pose"]["x_m"]}}
    params = {"fields": "localized,pose.x_m"}
    found = client.post(f"{part}/observations", content=queries[0], headers=PACKED, params=params)
    assert found.headers["content-type"] == PART_TYPE
    assert json.loads(found.content) == expected
    with open_stream(client, f"{streamed}/stream?fields=localized,pose.x_m") as stream:
        stream.send_bytes(queries[0])
        assert stream.receive_json() == expected


@pytest.mark.parametrize("fields", ["place", "pose.place", "best"])
def test_an_unknown_field_is_refused_and_nothing_is_observed(client, queries, fields):
    track = new_track(client)
    asked = {"content": queries[0], "headers": PACKED, "params": {"fields": fields}}
    refused = client.post(f"{track}/observations", **asked)
    assert problem_of(refused) == (422, "invalid-request")
    assert refused.json()["errors"][0]["where"] == "query/fields"
    with (
        pytest.raises(WebSocketDenialResponse) as denied,
        open_stream(client, f"{track}/stream?fields={fields}"),
    ):
        pass
    assert problem_of(denied.value) == (422, "invalid-request")
    assert denied.value.json()["errors"][0]["where"] == "query/fields"
    assert client.get(track).json()["last"] is None


def test_fields_of_a_packed_answer_are_refused_and_nothing_is_observed(client, queries):
    track = new_track(client)
    asked = {"content": queries[0], "params": {"fields": "localized"}}
    refused = client.post(f"{track}/observations", headers={**PACKED, **AS_PACKED}, **asked)
    assert problem_of(refused) == (422, "invalid-request")
    assert STEP.media_type in refused.json()["detail"]
    with (
        pytest.raises(WebSocketDenialResponse) as denied,
        open_stream(client, f"{track}/stream?fields=localized", subprotocols=[STREAM_PROTOCOL]),
    ):
        pass
    assert problem_of(denied.value) == (422, "invalid-request")
    assert client.get(track).json()["last"] is None
