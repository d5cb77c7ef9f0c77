"""Keys that are limited to maps."""

import re

import pytest

from tests.support.access import ADMIN, LOCALIZE, OPENED_BY, READ, WRITE, holder, send
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import problem_of


@pytest.fixture(scope="module")
def client(guarded):
    return guarded


@pytest.fixture(scope="module")
def of_dock(client):
    """Return the head of a key that may do all with map `dock`, and nothing with another."""
    return holder(client, READ, WRITE, LOCALIZE, maps=["dock", "new"])


@pytest.mark.parametrize("route", [route for route in OPENED_BY if "{map}" in route])
def test_a_map_is_not_found_with_a_key_of_other_maps(client, of_dock, route):
    method, _, path = route.partition(" ")
    given = {"map": "campus", "drive": "monday", "index": "0"}
    requested = re.sub(r"\{(\w+)\}", lambda part: given.get(part[1], "x" * 12), path)
    there = send(client, method, requested, of_dock)
    assert there == (404, "map-not-found")
    assert send(client, method, requested.replace("campus", "nowhere"), of_dock) == there


def test_a_hidden_map_gets_the_same_answer_as_a_missing_one(client, of_dock):
    hidden, missing = (
        client.get(f"/v1/maps/{slug}", headers=headers).json()
        for slug, headers in (("campus", of_dock), ("nowhere", ADMIN))
    )
    assert hidden.pop("request_id") != missing.pop("request_id")
    assert hidden == {**missing, "detail": missing["detail"].replace("nowhere", "campus")}


def test_lists_show_only_the_maps_of_the_key(client, of_dock):
    maps = client.get("/v1/maps", headers=of_dock).json()["items"]
    assert [one["map"] for one in maps] == ["dock"]
    assert client.get("/v1/jobs", headers=of_dock).json()["items"] == []
    assert len(client.get("/v1/jobs", headers=ADMIN).json()["items"]) == 2
    refused = client.get("/v1/jobs?map=campus", headers=of_dock)
    assert problem_of(refused) == (404, "map-not-found")


def test_a_job_of_another_map_is_not_found(client, of_dock):
    job, _ = client.get("/v1/jobs", headers=ADMIN).json()["items"]
    of_campus = holder(client, READ, WRITE, maps=["campus"])
    path = f"/v1/jobs/{job['job']}"
    assert client.get(path, headers=of_campus).json() == job
    for method, what in (("GET", path), ("GET", f"{path}/events"), ("DELETE", path)):
        assert problem_of(client.request(method, what, headers=of_dock)) == (404, "job-not-found")


def test_a_key_makes_no_map_but_its_own(client, of_dock):
    for slug in ("campus", "another"):
        refused = client.post("/v1/maps", json={"map": slug}, headers=of_dock)
        assert problem_of(refused) == (403, "scope-missing")
    assert client.post("/v1/maps", json={"map": "new"}, headers=of_dock).status_code == 201
    assert client.delete("/v1/maps/new", headers=of_dock).status_code == 204


def test_a_key_does_its_work_in_its_map(client):
    fleet = holder(client, LOCALIZE, maps=["campus"])
    found = client.post(
        "/v1/maps/campus/localizations/scan",
        content=kitti(recording().scans[9]),
        headers={**KITTI, **fleet},
    )
    assert found.json()["best"]["scan_index"] == 9
