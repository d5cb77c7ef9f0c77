"""Requests are accepted as the API describes them, and not otherwise."""

import json

import pytest

from tests.support.access import ADMIN
from tests.support.recording import recording, upload_scan
from tests.support.service import problem_of

JSON = {"Content-Type": "application/json"}
POSES = "/v1/maps/campus/drives/monday/poses"


def refusal(response):
    """Return the place and the wording of the one thing that is wrong."""
    assert problem_of(response) == (422, "invalid-request")
    [answer] = response.json()["errors"]
    return answer["where"], answer["what"]


def shown(value):
    return repr(value) if isinstance(value, str) else json.dumps(value)


@pytest.mark.parametrize("value", ["0.5", True, False])
def test_a_text_or_a_truth_value_is_no_number(client, value):
    item = {"scan": 0, "timestamp_s": value}
    refused = client.put(POSES, json={"poses": [item]})
    assert refusal(refused) == (
        "body/poses/0/timestamp_s",
        f"should be a valid number, got {shown(value)}",
    )


@pytest.mark.parametrize("value", ["0", True])
def test_a_text_or_a_truth_value_is_no_index(client, value):
    refused = client.put(POSES, json={"poses": [{"scan": value}]})
    assert refusal(refused) == (
        "body/poses/0/scan",
        f"should be a valid integer, got {shown(value)}",
    )
    refused = client.post("/v1/maps/campus/builds", json={"segments": value})
    assert refusal(refused) == ("body/segments", f"should be a valid integer, got {shown(value)}")


@pytest.mark.parametrize("value", ["true", 1, "yes"])
def test_a_text_or_a_number_is_no_truth_value(client, value):
    refused = client.post("/v1/maps/campus/builds", json={"make_live": value})
    assert refusal(refused) == ("body/make_live", f"should be true or false, got {shown(value)}")


@pytest.mark.parametrize("value", [1, 1.0, "true"])
def test_a_number_or_a_text_closes_no_drive_and_completes_no_capture(client, value):
    what = f"should be true or false, got {shown(value)}"
    drive = "/v1/maps/campus/drives/monday"
    for path, name in ((drive, "closed"), (f"{drive}/captures/{'0' * 32}", "complete")):
        assert refusal(client.patch(path, json={name: value})) == (f"body/{name}", what)


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("retained_revisions", True, "a whole number from 0 to 1000000, or 'all'"),
        ("retained_revisions", "1", "a whole number from 0 to 1000000, or 'all'"),
        ("retained_revisions", "ALL", "a whole number from 0 to 1000000, or 'all'"),
        ("retained_revisions", -1, "a whole number from 0 to 1000000, or 'all'"),
        ("retained_revisions", 1_000_001, "a whole number from 0 to 1000000, or 'all'"),
        ("retained_revisions", 0.5, "a whole number from 0 to 1000000, or 'all'"),
        ("retained_for_days", False, "a valid number"),
        ("retained_for_days", "1", "a valid number"),
    ],
)
def test_a_retention_that_is_none_is_refused_with_one_text(client, name, value, wanted):
    refused = client.patch("/v1/maps/campus", json={"retention": {name: value}})
    what = f"should be {wanted}, got {shown(value)}"
    assert refusal(refused) == (f"body/retention/{name}", what)


@pytest.mark.parametrize("value", ["yes", "1", "on", "t", "True", "FALSE", "no", ""])
def test_a_truth_value_of_a_query_is_true_or_false(own, value):
    own.post("/v1/maps", json={"map": "yard"})
    for method, path, name in (
        ("DELETE", "/v1/maps/yard", "purge"),
        ("DELETE", "/v1/maps/campus/drives/monday", "purge"),
        ("POST", "/v1/maps/campus/revisions", "make_live"),
        ("PUT", POSES, "partial"),
    ):
        refused = own.request(method, f"{path}?{name}={value}")
        where, what = refusal(refused)
        assert where == f"query/{name}"
        assert "wanted true or false" in what
    assert own.delete("/v1/maps/yard?purge=false").status_code == 204
    assert [item["map"] for item in own.get("/v1/recycle-bin").json()["items"]] == ["yard"]


def test_an_integer_may_be_written_with_a_point(own):
    taken = own.put(POSES, content=b'{"poses": [{"scan": 3.0, "timestamp_s": 2}]}', headers=JSON)
    assert taken.status_code == 200
    stored = own.service.store.drives.get("campus", "monday")
    assert stored.scans == 48
    refused = own.put(POSES, content=b'{"poses": [{"scan": 3.5}]}', headers=JSON)
    assert refusal(refused)[0] == "body/poses/0/scan"


@pytest.mark.parametrize("value", [1_679_000_000_000_000_000, 1_679_000_000_000, -1e300])
def test_a_time_of_a_scan_is_in_seconds(client, value):
    refused = client.put(POSES, json={"poses": [{"scan": 0, "timestamp_s": value}]})
    where, what = refusal(refused)
    assert where == "body/poses/0/timestamp_s"
    assert "wanted seconds" in what
    scan = recording().scans[0]
    refused = upload_scan(client, "campus", "monday", 900, scan, params={"timestamp_s": value})
    assert refusal(refused) == ("query/timestamp_s", what)


@pytest.mark.parametrize("moment", ["0.5", "1700000000", "2030-01-01", "2030-01-01T00:00:00", ""])
def test_a_time_is_returned_with_its_time_zone(client, moment):
    for name in ("since", "until"):
        assert refusal(client.get("/v1/audit", params={name: moment}))[0] == f"query/{name}"
    body = {"name": "fleet", "scopes": ["admin"], "expires_at": moment}
    assert refusal(client.post("/v1/keys", json=body))[0] == "body/expires_at"


@pytest.mark.parametrize("moment", ["0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00"])
def test_a_time_outside_the_calendar_in_utc_is_a_client_error(client, moment):
    what = f"wanted a moment that is in the years 1 to 9999 in UTC too, got {moment!r}"
    for name in ("since", "until"):
        refused = client.get("/v1/audit", params={name: moment})
        assert refusal(refused) == (f"query/{name}", what)
    body = {"name": "fleet", "scopes": ["admin"], "expires_at": moment}
    assert refusal(client.post("/v1/keys", json=body)) == ("body/expires_at", what)


@pytest.mark.parametrize("moment", ["0001-01-01T00:00:00Z", "9999-12-31T23:59:59.999999Z"])
def test_the_first_and_the_last_time_of_the_calendar_are_accepted(client, moment):
    assert client.get("/v1/audit", params={"since": moment}).status_code == 200


def test_a_key_may_last_until_the_end_of_the_calendar(guarded):
    body = {"name": "f", "scopes": ["localize"], "expires_at": "9999-12-31T23:59:59+14:00"}
    made = guarded.post("/v1/keys", json=body, headers=ADMIN)
    assert made.status_code == 201
    assert made.json()["expires_at"] == "9999-12-31T09:59:59Z"


def test_a_number_is_not_a_time(client):
    body = {"name": "fleet", "scopes": ["admin"], "expires_at": 4102444800}
    assert refusal(client.post("/v1/keys", json=body))[0] == "body/expires_at"


@pytest.mark.parametrize("moment", ["2030-01-01T00:00:00Z", "2030-01-01t02:00:00.25+02:00"])
def test_a_time_may_have_any_time_zone(client, moment):
    assert client.get("/v1/audit", params={"until": moment}).status_code == 200


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("keys", {"name": "fleet", "scopes": ["localize", "localize"]}),
        ("keys", {"name": "fleet", "scopes": ["localize"], "maps": ["campus", "campus"]}),
        ("tokens", {"scopes": ["localize", "localize"]}),
        ("tokens", {"maps": ["campus", "campus"]}),
    ],
)
def test_a_repeated_item_of_a_set_is_rejected(client, path, body):
    where, what = refusal(client.post(f"/v1/{path}", json=body))
    assert where in {"body/scopes", "body/maps"}
    assert what == "an item comes twice"


@pytest.mark.parametrize(
    "etag",
    ["1", "1_0", '"1_0"', '"+1"', '""', '"one"', 'W/""', '"1', '"' + "9" * 19 + '"', "null", ""],
)
def test_an_invalid_etag_changes_nothing(client, etag):
    before = client.get("/v1/maps/campus").json()
    headers = {"If-Match": etag}
    for refused in (
        client.patch("/v1/maps/campus", json={"description": "other"}, headers=headers),
        client.put("/v1/maps/campus/live", json={"revision": "0" * 12}, headers=headers),
        client.delete("/v1/maps/campus", headers=headers),
    ):
        assert problem_of(refused) == (422, "invalid-request")
    assert client.get("/v1/maps/campus").json() == before


def test_errors_of_a_proposal_are_those_of_its_own_kind(client):
    first = {"drive": "monday", "scan_index": 0}
    for second, lacks in (
        ({"drive": "monday"}, "body/proposals/0/second/scan_index"),
        ({"basis": "0f" * 32, "signatures": []}, "body/proposals/0/second/signatures"),
    ):
        body = {"proposals": [{"first": first, "second": second}]}
        assert refusal(client.post("/v1/maps/campus/loop-closures", json=body))[0] == lacks


# How it is described


@pytest.fixture(scope="module")
def paths(client):
    return client.documented["paths"]


def test_no_parameter_may_be_null(paths):
    for operations in paths.values():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                assert {"type": "null"} not in parameter["schema"].get("anyOf", ()), parameter


def test_an_optional_parameter_keeps_its_bounds(paths):
    requested = paths["/v1/maps/{map}/localizations/scan"]["post"]["parameters"]
    [least] = [item["schema"] for item in requested if item["name"] == "min_probability"]
    assert (least["type"], least["minimum"], least["maximum"]) == ("number", 0, 1)
    assert least["description"]


def test_the_events_of_a_job_are_described(paths):
    answer = paths["/v1/jobs/{job}/events"]["get"]["responses"]["200"]["content"]
    events = answer["text/event-stream"]["schema"]
    assert events["type"] == "string"
    assert "`data`, a JobOut as JSON" in events["description"]
