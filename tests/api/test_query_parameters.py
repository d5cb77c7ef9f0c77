"""Parameters of a query are those of the route: a mistyped one is no missing one."""

import re

import pytest
from starlette.testclient import WebSocketDenialResponse

from tests.support.access import ADMIN
from tests.support.campus import MAP, PACKED, signed
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import document, problem_of

LOCALIZED = f"{MAP}/localizations/signature"


def refusals(response):
    """Return what was refused, by its place."""
    assert problem_of(response) == (422, "invalid-request")
    return {error["where"]: error["what"] for error in response.json()["errors"]}


@pytest.mark.parametrize(
    ("method", "path", "name"),
    [
        ("POST", f"{LOCALIZED}?x_m=0&min_probabilty=1", "min_probabilty"),
        ("PUT", f"{MAP}/drives/monday/scans/0?timestamp=5", "timestamp"),
        ("GET", "/v1/jobs?kind=build", "kind"),
        ("GET", "/v1/jobs?=", ""),
        ("GET", "/v1/jobs?Map=campus", "Map"),
        ("GET", f"{MAP}?x", "x"),
        ("GET", f"{MAP}/topology?segment=1", "segment"),
        ("POST", f"{MAP}/tracks/none/observations?seq=17", "seq"),
        ("GET", "/v1/jobs/none/events?after=3", "after"),
        ("GET", "/version?verbose", "verbose"),
        ("POST", "/v1/localizations/signature?x_m=1", "x_m"),
    ],
)
def test_a_parameter_that_the_route_does_not_have_is_refused_by_name(client, method, path, name):
    refused = refusals(client.request(method, path))
    assert f"query/{name}" in refused


def test_a_probe_with_a_query_is_answered_as_any_other(client):
    assert client.get("/livez?verbose").json() == {"status": "live"}
    assert client.get("/readyz?time=1&time=2").json()["ready"]


def test_the_refusal_names_the_parameters_that_the_route_has(client, built):
    body = signed(client, built.live)
    for query in ("min_probabilty=0.99&k=2", "k=none&min_probabilty=0.99"):
        refused = client.post(f"{LOCALIZED}?{query}", content=body, headers=PACKED)
        what = refusals(refused)["query/min_probabilty"]
        assert "min_probability" in what
        assert "since_drive" in what
    assert "has no query" in refusals(client.get(f"{MAP}?x=1"))["query/x"]


def test_a_parameter_comes_once_unless_it_is_a_list(client, built):
    body = signed(client, built.live)
    twice = client.post(f"{LOCALIZED}?k=1&k=2", content=body, headers=PACKED)
    assert "2 times" in refusals(twice)["query/k"]
    assert "query/map" in refusals(client.get("/v1/jobs?map=campus&map=campus"))
    listed = client.post(f"{LOCALIZED}?segment=0&segment=1", content=body, headers=PACKED)
    assert listed.status_code == 200
    assert client.get(f"{MAP}/basis?segment=0&segment=1").status_code == 200


def numbers_of_routes():
    """Yield each parameter that is a number: a request with it as `1_0`, its place and type."""
    for path, operations in document()["paths"].items():
        for method, operation in operations.items():
            for parameter in operation.get("parameters", ()):
                name, source, schema = (parameter[part] for part in ("name", "in", "schema"))
                kind = schema.get("items", schema).get("type")
                if kind not in {"integer", "number"}:
                    continue
                assert source in {"path", "query"}, "wanted: a check of such a header"
                url = path.replace(f"{{{name}}}", "1_0") if source == "path" else path
                for other, text in (("index", "0"), ("part", "0"), (r"\w+", "campus")):
                    url = re.sub(rf"\{{{other}\}}", text, url)
                query = f"?{name}=%31%5F0" if source == "query" else ""
                yield method, url + query, f"{source}/{name}", kind


def test_a_number_of_any_route_has_no_underscores(client):
    """Python reads `1_0` as 10; JSON and other languages do not."""
    requests = list(numbers_of_routes())
    assert len(requests) > 60
    for method, url, where, kind in requests:
        assert refusals(client.request(method, url)) == {
            where: f"should be a valid {kind}, got '1_0'"
        }, (method, url)


def test_nothing_is_stored_under_a_mistyped_parameter(own):
    path = f"{MAP}/drives/tuesday/scans/0"
    body = kitti(recording().scans[0])
    assert refusals(own.put(f"{path}?timestamp=5", content=body, headers=KITTI))
    assert problem_of(own.get(f"{MAP}/drives/tuesday")) == (404, "drive-not-found")
    assert own.put(f"{path}?timestamp_s=5", content=body, headers=KITTI).status_code == 201


def test_a_key_is_checked_before_its_parameters_and_the_refused_change_is_logged(guarded):
    assert problem_of(guarded.delete(f"{MAP}?prge=true")) == (401, "key-needed")
    refused = guarded.delete(f"{MAP}?prge=true", headers=ADMIN)
    assert "query/prge" in refusals(refused)
    logged = guarded.get("/v1/audit?limit=1000", headers=ADMIN).json()["items"]
    assert (logged[-1]["action"], logged[-1]["outcome"]) == ("delete_map", "422")


def test_a_stream_refuses_a_parameter_as_other_routes_do(client):
    track = client.post(f"{MAP}/tracks").json()["track"]
    url = f"ws://127.0.0.1{MAP}/tracks/{track}/stream"
    with pytest.raises(WebSocketDenialResponse) as denied, client.websocket_connect(f"{url}?k=1"):
        pass
    assert problem_of(denied.value) == (422, "invalid-request")
    assert denied.value.json()["errors"][0]["where"] == "query/k"
    with client.websocket_connect(url):
        pass


def test_every_route_but_the_probes_documents_the_refusal():
    for path, operations in document()["paths"].items():
        for method, operation in operations.items():
            if path in {"/livez", "/readyz", "/metrics"}:
                assert "422" not in operation["responses"]
                continue
            documented = operation["responses"]["422"]["content"]["application/problem+json"]
            assert "invalid-request" in documented["examples"], f"{method} {path}"
