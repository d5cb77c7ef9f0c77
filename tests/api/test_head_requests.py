"""HEAD: what GET would answer, without the body."""

import pytest

from tests.support.access import ADMIN
from tests.support.campus import MAP

_OF_ONE_REQUEST = {"x-request-id", "ratelimit"}
_CHANGES = {"content-length"}  # of metrics, which count the request too


def head_of(response, without=_OF_ONE_REQUEST):
    return {name: value for name, value in response.headers.items() if name not in without}


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/docs",
        "/openapi.json",
        "/livez",
        "/readyz",
        "/version",
        "/problems/map-not-found",
        "/problems/nonsense",
        "/v1/maps",
        "/v1/maps?limit=0",
        "/v1/maps?colour=red",
        "/v1/maps/nowhere",
        MAP,
        f"{MAP}/basis",
        f"{MAP}/topology",
        f"{MAP}/drives/monday",
        f"{MAP}/drives/monday/scans/0",
        f"{MAP}/tracks/none/stream",
        "/v1/jobs",
        "/v1/jobs/none",
        "/v1/audit",
        "/v1/nowhere",
    ],
)
def test_head_has_the_status_and_head_of_get(client, path):
    got = client.get(path, follow_redirects=False)
    answer = client.head(path, follow_redirects=False)
    assert answer.status_code == got.status_code
    assert head_of(answer) == head_of(got)


def test_the_head_of_a_download_is_sent_without_reading_the_file(client, built):
    path = f"{MAP}/revisions/{built.live}/file"
    got, answer = client.get(path), client.head(path)
    assert (answer.status_code, head_of(answer)) == (200, head_of(got))
    assert answer.content == b""


def test_head_of_metrics_is_that_of_get_and_counted_by_its_route_and_method(client):
    without = _OF_ONE_REQUEST | _CHANGES
    answer, got = client.head("/metrics"), client.get("/metrics")
    assert (answer.status_code, head_of(answer, without)) == (200, head_of(got, without))
    counted = 'tensormap_http_requests_total{method="HEAD",route="/metrics",status="200"}'
    assert counted in got.text


def test_events_have_no_head_because_they_do_not_end(client, built):
    refused = client.head(f"/v1/jobs/{built.job}/events")
    assert (refused.status_code, refused.headers["allow"]) == (405, "GET")


def test_head_of_what_has_no_get_is_rejected(client):
    refused = client.head(f"{MAP}/builds")
    assert (refused.status_code, refused.headers["allow"]) == (405, "POST")


def test_head_needs_the_key_that_get_needs_and_is_no_change_in_the_audit_log(guarded):
    before = guarded.get("/v1/audit", headers=ADMIN).json()
    assert guarded.head("/v1/maps").status_code == 401
    assert guarded.head("/v1/maps", headers=ADMIN).status_code == 200
    assert guarded.get("/v1/audit", headers=ADMIN).json() == before


def test_the_document_describes_get_alone(client):
    assert not any("head" in item for item in client.documented["paths"].values())
