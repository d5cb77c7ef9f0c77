"""Scopes: every route with every scope."""

import re

import pytest
from fastapi import APIRouter, Depends
from fastapi.routing import APIRoute, APIWebSocketRoute, iter_route_contexts

from app.access.dependency import require_access
from app.access.scopes import Scope, needs
from app.main import create_app
from app.settings import Settings
from storage.errors import StorageUnavailable
from tests.support.access import (
    ADMIN,
    ADMIN_KEY,
    LOCALIZE,
    METRICS,
    OPENED_BY,
    READ,
    WRITE,
    bearer,
    holder,
    send,
)
from tests.support.service import Client, problem_of

PARTS = {"index": "0", "part": "0"}

NEED_NO_KEY = {
    "GET /",
    "GET /livez",
    "GET /readyz",
    "GET /version",
    "GET /problems/{name}",
    "GET /docs",
    "GET /docs/oauth2-redirect",
    "WS /{path:path}",  # no route: it is refused
}


def routes_of_the_service():
    for route in iter_route_contexts(create_app(Settings()).routes):
        if isinstance(route.original_route, APIWebSocketRoute):
            yield f"WS {route.path}"
        elif isinstance(route.original_route, APIRoute):
            yield from (f"{method} {route.path}" for method in route.methods or ())


@pytest.fixture(scope="module")
def client(guarded):
    return guarded


@pytest.fixture(scope="module")
def holders(client):
    return {scope: holder(client, scope) for scope in Scope}


def test_no_route_is_without_a_line_in_the_table():
    assert set(routes_of_the_service()) == OPENED_BY.keys() | NEED_NO_KEY


@pytest.mark.parametrize("scope", Scope)
@pytest.mark.parametrize("route", OPENED_BY)
def test_a_route_opens_for_its_scopes_and_for_no_other(client, holders, route, scope):
    method, _, path = route.partition(" ")
    requested = re.sub(r"\{(\w+)\}", lambda part: PARTS.get(part[1], "x" * 12), path)
    status, problem = send(client, method, requested, holders[scope])
    if scope is Scope.ADMIN or scope in OPENED_BY[route]:
        assert status not in {401, 403}, problem
    else:
        assert (status, problem) == (403, "scope-missing")


def test_the_description_names_the_scopes_of_each_route(client):
    paths = client.documented["paths"]
    for route, scopes in OPENED_BY.items():
        method, _, path = route.partition(" ")
        if method == "WS":
            continue
        answer = [
            scope for way in paths[path][method.lower()]["security"] for scope in way.values()
        ]
        assert sorted(answer) == sorted([scope.value] for scope in scopes or {Scope.ADMIN}), route


def test_a_route_that_declares_no_scope_is_the_administrators(tmp_path):
    app = create_app(Settings(data_dir=tmp_path, admin_key=ADMIN_KEY))
    router = APIRouter(prefix="/v1", dependencies=[Depends(require_access)])

    @router.get("/forgotten")
    def forgotten() -> str:
        return "content"

    app.include_router(router)
    with Client(app) as client:
        assert client.get("/v1/forgotten", headers=ADMIN).json() == "content"
        everything_else = holder(client, READ, WRITE, LOCALIZE, METRICS)
        refused = client.get("/v1/forgotten", headers=everything_else)
        assert problem_of(refused) == (403, "scope-missing")


def test_a_declaration_names_a_scope():
    with pytest.raises(ValueError, match="at least one"):
        needs()


def test_a_rejection_names_the_needed_scope(client, holders):
    refused = client.get("/v1/maps/campus/basis", headers=holders[WRITE])
    assert refused.headers["WWW-Authenticate"] == (
        'Bearer error="insufficient_scope", scope="maps:read localize"'
    )
    assert "needs maps:read or localize" in refused.json()["detail"]


def test_nothing_is_read_of_a_request_without_a_key(client):
    whole = {"Content-Type": "application/json"}
    for headers in (whole, {**whole, **bearer("x" * 50)}, {**whole, "Content-Encoding": "gzip"}):
        refused = client.post("/v1/maps", content=b'{"map": [[[', headers=headers)
        assert problem_of(refused)[0] == 401
    assert problem_of(client.get("/v1/nothing"))[0] == 401
    assert problem_of(client.get("/v1/nothing", headers=ADMIN)) == (404, "no-such-route")


def test_no_request_is_accepted_while_keys_cannot_be_looked_up(client, monkeypatch, caplog):
    def fail(*_):
        raise StorageUnavailable("the catalog is away")

    reader = holder(client, READ)
    monkeypatch.setattr(client.service.store.keys, "with_hash", fail)
    refused = client.get("/v1/maps", headers=reader)
    assert problem_of(refused) == (503, "storage-unavailable")
    assert "cannot be checked: the catalog is away" in caplog.text
    assert not [record for record in caplog.records if record.exc_info]


def test_a_route_without_a_guard_is_closed(tmp_path):
    app = create_app(Settings(data_dir=tmp_path, admin_key=ADMIN_KEY))
    router = APIRouter(prefix="/v2", dependencies=[Depends(require_access)])

    @router.get("/maps", dependencies=[needs(READ)])
    def maps() -> str:
        return "content"

    app.include_router(router)
    with Client(app) as client:
        assert problem_of(client.get("/v2/maps", headers=ADMIN)) == (401, "key-needed")
