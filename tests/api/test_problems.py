"""Errors: one table, one shape, each explained, without internal details."""

import importlib
import logging
import pkgutil

import pytest
from fastapi.routing import APIRoute, iter_route_contexts

import app
import core
import storage
from app.http.errors import STATUS, AppError, TooManyTracks
from app.http.problems import problem_name
from app.main import create_app
from app.settings import Settings
from core.errors import TensorMapError
from storage.errors import Conflict, LostRace, NotFound, StorageError, StorageFailure
from tests.support.recording import KITTI, recording, upload_scan
from tests.support.service import problem_of, whole_store

# Never raised themselves; who loses a race tries again, and LostRace is a StorageBusy if not.
BASES = {
    TensorMapError,
    AppError,
    StorageError,
    StorageFailure,
    NotFound,
    Conflict,
    LostRace,
}


def whole_tree(kind):
    return {kind}.union(*(whole_tree(below) for below in kind.__subclasses__()))


def test_every_error_that_is_raised_has_its_status():
    for package in (app, core, storage):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            # Alembic runs the migrations; a __main__ runs itself.
            if "migrations" not in module.name and "__main__" not in module.name:
                importlib.import_module(module.name)
    assert whole_tree(TensorMapError) - BASES == set(STATUS)


@pytest.mark.parametrize("kind", STATUS, ids=problem_name)
def test_every_problem_is_explained(client, kind):
    page = client.get(f"/problems/{problem_name(kind)}").json()
    assert page["type"] == f"/problems/{problem_name(kind)}"
    assert page["title"].endswith((".", "`."))
    assert page["status"] == STATUS[kind]


def test_an_unknown_problem_is_not_found(client):
    assert problem_of(client.get("/problems/nonsense")) == (404, "no-such-route")


def test_a_path_that_is_not_there_is_a_problem_too(client):
    assert problem_of(client.get("/v1/nothing")) == (404, "no-such-route")
    long = client.get("/v1/" + "x" * 5_000)
    assert problem_of(long) == (404, "no-such-route")
    assert len(long.content) < 1_000


@pytest.mark.parametrize("path", ["/v1/maps/", "/v1/maps/campus/", "/livez/", "/docs/"])
def test_a_path_with_a_slash_too_many_is_no_route_and_redirects_nowhere(client, path):
    for method in ("GET", "HEAD", "POST"):
        answer = client.request(method, path, follow_redirects=False)
        assert answer.status_code == 404
        assert "Location" not in answer.headers
    assert problem_of(client.get(path, follow_redirects=False)) == (404, "no-such-route")


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PUT", "/v1/maps", "GET, HEAD, POST"),
        ("POST", "/v1/maps/campus", "DELETE, GET, HEAD, PATCH"),
        ("DELETE", "/v1/maps/campus/drives/monday/scans/0", "GET, HEAD, PUT"),
        ("GET", "/v1/maps/campus/builds", "POST"),
        ("POST", "/livez", "GET, HEAD"),
        ("POST", "/openapi.json", "GET, HEAD"),
        ("POST", "/static-offline-docs/favicon.png", "GET, HEAD"),  # of an application of its own
    ],
)
def test_a_method_that_a_path_lacks_is_rejected_with_those_it_has(client, method, path, allowed):
    refused = client.request(method, path)
    assert problem_of(refused) == (405, "method-not-allowed")
    assert refused.headers["Allow"] == allowed
    assert refused.json()["detail"].endswith(f"has no {method}, it has {allowed}")


def test_no_route_leaves_its_body_to_fastapi():
    # What FastAPI raises while it reads one, a problem would have to be made of.
    routes = [of.original_route for of in iter_route_contexts(create_app(Settings()).routes)]
    ours = [route for route in routes if isinstance(route, APIRoute)]
    assert len(ours) > 40
    assert [route.path for route in ours if route.body_field is not None] == []


def test_an_internal_error_reveals_nothing_of_the_inside(own, monkeypatch, caplog):
    def fault(*_args):
        raise ZeroDivisionError("secret of the inside")

    monkeypatch.setattr(own.service.store.maps, "get", fault)
    failed = own.get("/v1/maps/campus")
    assert problem_of(failed) == (500, "internal-error")
    assert "secret" not in failed.text
    assert "secret of the inside" in caplog.text  # the log does


def test_a_limit_that_is_reached_is_no_error_in_the_log(own, monkeypatch, caplog):
    def reached(*_):
        raise TooManyTracks("the limit of 1000 tracks of the service is reached")

    monkeypatch.setattr(own.service.tracks, "create", reached)
    refused = own.post("/v1/maps/campus/tracks")
    assert problem_of(refused) == (503, "too-many-tracks")
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize(
    "slug",
    [
        "..%2f..%2fsecret",
        "%2e%2e",
        "%00",
        "a%00b",
        "a" * 65,
        "a" * 10_000,
        "Campus",
        "%C3%A9t%C3%A9",
        "%ff",
        "-a",
        ".hidden",
        "a%20b",
        "a;b",
        "%F0%9F%9A%97",
    ],
)
def test_a_name_that_is_no_slug_reaches_no_file(client, built, slug):
    before = whole_store(client)
    beside = sorted(path.name for path in built.data_dir.parent.iterdir())
    requested = [
        ("GET", f"/v1/maps/{slug}", None),
        ("DELETE", f"/v1/maps/{slug}", None),
        ("GET", f"/v1/maps/{slug}/drives", None),
        ("PUT", f"/v1/maps/{slug}/drives/d/scans/0", bytes(range(1, 17)) * 200),
        ("GET", f"/v1/maps/campus/drives/{slug}", None),
        ("DELETE", f"/v1/maps/campus/drives/{slug}", None),
        ("PUT", f"/v1/maps/campus/drives/{slug}/scans/0", bytes(range(1, 17)) * 200),
        ("GET", f"/v1/maps/campus/revisions/{slug}/file", None),
        ("DELETE", f"/v1/maps/campus/revisions/{slug}", None),
        ("GET", f"/v1/jobs/{slug}", None),
        ("GET", f"/problems/{slug}", None),
        ("GET", f"/static-offline-docs/{slug}", None),
    ]
    for method, path, body in requested:
        refused = client.request(method, path, content=body, headers=KITTI if body else None)
        assert refused.status_code in {404, 405, 422}, path
    assert whole_store(client) == before
    assert sorted(path.name for path in built.data_dir.parent.iterdir()) == beside


@pytest.mark.parametrize("slug", ["", "..", "A", "a/b", "a\x00", "é", "a" * 65, ".a", "a b", "a\n"])
def test_a_map_is_made_only_of_a_slug(client, slug):
    refused = client.post("/v1/maps", json={"map": slug})
    assert problem_of(refused) == (422, "invalid-slug")


@pytest.mark.parametrize("slug", ["0", "a.b_c-9", "a" * 64])
def test_a_slug_names_a_map_and_a_drive(own, slug):
    made = own.post("/v1/maps", json={"map": slug})
    assert made.headers["Location"] == f"/v1/maps/{slug}"
    assert upload_scan(own, slug, slug, 0, recording().scans[0]).status_code == 201
    assert problem_of(own.post("/v1/maps", json={"map": slug})) == (409, "map-exists")


def test_a_map_is_changed_only_at_the_version_that_was_seen(own):
    seen = own.get("/v1/maps/campus").headers["ETag"]
    changed = own.patch(
        "/v1/maps/campus", json={"description": "one"}, headers={"If-Match": f"W/{seen}"}
    )
    assert changed.status_code == 200
    late = {"If-Match": seen}
    for refused in (
        own.patch("/v1/maps/campus", json={"description": "two"}, headers=late),
        own.delete("/v1/maps/campus", headers=late),
    ):
        assert problem_of(refused) == (412, "map-changed")
    nonsense = own.delete("/v1/maps/campus", headers={"If-Match": seen.strip('"')})
    assert 'with its quotes, as "4"' in nonsense.json()["detail"]
    assert problem_of(nonsense) == (422, "invalid-request")
    gone = own.delete("/v1/maps/campus", headers={"If-Match": changed.headers["ETag"]})
    assert gone.status_code == 204
    assert problem_of(own.get("/v1/maps/campus")) == (404, "map-not-found")


def test_lists_are_walked_page_by_page(own):
    for name in ("a", "b", "c"):
        own.post("/v1/maps", json={"map": name})
    seen, after = [], ""
    while after is not None:
        page = own.get("/v1/maps", params={"limit": 2, "after": after}).json()
        seen += [item["map"] for item in page["items"]]
        after = page["next_after"]
    assert seen == ["a", "b", "c", "campus"]
    for limit in (0, 1001, "many"):
        assert problem_of(own.get("/v1/maps", params={"limit": limit})) == (422, "invalid-request")
    for path in ("/v1/jobs", "/v1/maps/campus/revisions"):
        nonsense = own.get(path, params={"after": "nonsense"})
        assert problem_of(nonsense) == (422, "invalid-parameters")


def test_a_drive_is_removed_with_its_scans_and_its_revisions_stay(own, built):
    assert own.delete("/v1/maps/campus/drives/monday").status_code == 204
    gone = own.get("/v1/maps/campus/drives/monday/scans/0")
    assert problem_of(gone) == (404, "drive-not-found")
    assert own.get(f"/v1/maps/campus/revisions/{built.live}/file").status_code == 200
    assert own.get("/v1/maps/campus/basis").status_code == 200


@pytest.mark.parametrize(
    ("query", "what"),
    [
        ("k=abc", "should be a valid integer, got 'abc'"),
        ("k=0", "should be greater than or equal to 1, got '0'"),
        ("min_probability=much", "should be a valid number, got 'much'"),
        ("fields=localised", "an answer has no field 'localised', it has revision, live_revision"),
        ("fields=best.place", "an answer has no field 'best.place', best has segment, fraction"),
        ("fields=", "an answer has no field '', it has revision, live_revision"),
        ("fields=ratio.x", "an answer has no field 'ratio.x', ratio has no fields"),
    ],
)
def test_a_wrong_parameter_is_answered_with_what_was_wanted_and_what_came(client, query, what):
    refused = client.post(f"/v1/maps/campus/localizations/signature?{query}")
    assert problem_of(refused) == (422, "invalid-request")
    [error] = refused.json()["errors"]
    assert error["where"] == f"query/{query.partition('=')[0]}"
    assert error["what"].startswith(what)


def test_wrong_json_is_answered_with_its_place_in_the_json(client):
    refused = client.patch("/v1/maps/campus", json={"retention": {"retained_revisions": "x"}})
    assert problem_of(refused) == (422, "invalid-request")
    assert {error["where"] for error in refused.json()["errors"]} == {
        "body/retention/retained_revisions"
    }
    query = {"basis": "0" * 64, "signatures": [{"segment": 0, "values": [["x"]]}]}
    refused = client.post("/v1/maps/campus/localizations/batch", json={"queries": [query]})
    [error] = refused.json()["errors"]
    assert error["where"] == "body/queries/0/signatures/0/values/0/0"
    assert error["what"] == "should be a valid number, got 'x'"


@pytest.mark.parametrize("slash", ["%2F", "%2f"])
def test_an_encoded_slash_is_part_of_a_name_and_leads_to_nothing_below_it(own, slash):
    """RFC 3986, 2.2: a page that encodes a map's name would delete a drive."""
    before = whole_store(own)
    for method, path in [
        ("DELETE", f"/v1/maps/campus{slash}drives{slash}monday"),
        ("DELETE", f"/v1/maps/campus/drives{slash}monday"),
        ("GET", f"/v1{slash}maps"),
        ("HEAD", f"/v1/maps/campus{slash}drives"),
        ("PATCH", f"/v1/maps/campus{slash}drives/monday"),
    ]:
        answer = own.request(method, path)
        assert answer.status_code == 404, path
        if method != "HEAD":
            assert problem_of(answer) == (404, "no-such-route")
            assert slash.upper() in answer.json()["detail"].upper()
    assert whole_store(own) == before
    assert own.get("/v1/maps?after=%2F").status_code == 200
