"""What a key opens: every route with every scope, limits to maps, expiry, revocation."""

import re
import threading
import time
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import pytest
from fastapi import APIRouter, Depends
from fastapi.routing import APIRoute, APIWebSocketRoute, iter_route_contexts
from fastapi.sse import format_sse_event
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from app.access.dependency import require_access
from app.access.scopes import Scope, needs
from app.access.secrets import secret_hash
from app.main import create_app
from app.settings import Settings
from storage.errors import StorageUnavailable
from tests.support.process import until
from tests.support.service import Client, copy_of, problem_of, running

ADMIN_KEY = "correct horse battery staple"
READ, WRITE, LOCALIZE = Scope.MAPS_READ, Scope.MAPS_WRITE, Scope.LOCALIZE
PARTS = {"index": "0"}

OPENED_BY = {
    "GET /v1/maps": {READ},
    "POST /v1/maps": {WRITE},
    "GET /v1/maps/{map}": {READ},
    "PATCH /v1/maps/{map}": {WRITE},
    "DELETE /v1/maps/{map}": {WRITE},
    "GET /v1/maps/{map}/drives": {READ, WRITE},
    "GET /v1/maps/{map}/drives/{drive}": {READ, WRITE},
    "PATCH /v1/maps/{map}/drives/{drive}": {WRITE},
    "DELETE /v1/maps/{map}/drives/{drive}": {WRITE},
    "GET /v1/maps/{map}/drives/{drive}/scans": {READ, WRITE},
    "POST /v1/maps/{map}/drives/{drive}/scans": {WRITE},
    "GET /v1/maps/{map}/drives/{drive}/scans/{index}": {READ},
    "PUT /v1/maps/{map}/drives/{drive}/scans/{index}": {WRITE},
    "PUT /v1/maps/{map}/drives/{drive}/poses": {WRITE},
    "POST /v1/maps/{map}/builds": {WRITE},
    "GET /v1/jobs": {READ, WRITE},
    "GET /v1/jobs/{job}": {READ, WRITE},
    "DELETE /v1/jobs/{job}": {WRITE},
    "GET /v1/jobs/{job}/events": {READ, WRITE},
    "GET /v1/maps/{map}/revisions": {READ},
    "POST /v1/maps/{map}/revisions": {WRITE},
    "GET /v1/maps/{map}/revisions/{revision}": {READ},
    "GET /v1/maps/{map}/revisions/{revision}/file": {READ},
    "GET /v1/maps/{map}/revisions/{revision}/comparison": {READ},
    "DELETE /v1/maps/{map}/revisions/{revision}": {WRITE},
    "PUT /v1/maps/{map}/live": {WRITE},
    "GET /v1/maps/{map}/basis": {READ, LOCALIZE},
    "GET /v1/maps/{map}/topology": {READ},
    "POST /v1/maps/{map}/localizations/scan": {LOCALIZE},
    "POST /v1/maps/{map}/localizations/image": {LOCALIZE},
    "POST /v1/maps/{map}/localizations/signature": {LOCALIZE},
    "POST /v1/maps/{map}/loop-closures": {LOCALIZE},
    "POST /v1/maps/{map}/tracks": {LOCALIZE},
    "GET /v1/maps/{map}/tracks/{track}": {LOCALIZE},
    "DELETE /v1/maps/{map}/tracks/{track}": {LOCALIZE},
    "POST /v1/maps/{map}/tracks/{track}/observations": {LOCALIZE},
    "WS /v1/maps/{map}/tracks/{track}/stream": {LOCALIZE},
    "POST /v1/keys": set(),
    "GET /v1/keys": set(),
    "GET /v1/keys/{key}": set(),
    "DELETE /v1/keys/{key}": set(),
    "GET /v1/audit": set(),
    "GET /metrics": set(),
    "POST /v1/tokens": {READ, WRITE, LOCALIZE},
}
"""Which scopes open a route, besides `admin`, which opens all."""

NEED_NO_KEY = {
    "GET /",
    "GET /livez",
    "GET /readyz",
    "GET /version",
    "GET /problems/{name}",
    "GET /docs",
    "GET /docs/oauth2-redirect",
    "GET /redoc",
}


def routes_of_the_service():
    for route in iter_route_contexts(create_app(Settings()).routes):
        if isinstance(route.original_route, APIWebSocketRoute):
            yield f"WS {route.path}"
        elif isinstance(route.original_route, APIRoute):
            yield from (f"{method} {route.path}" for method in route.methods or ())


def bearer(secret):
    return {"Authorization": f"Bearer {secret}"}


ADMIN = bearer(ADMIN_KEY)


def make(client, *scopes, **limits):
    wanted = {"name": "a test's", "scopes": list(scopes), **limits}
    made = client.post("/v1/keys", json=wanted, headers=ADMIN)
    assert made.status_code == 201, made.text
    return made.json()


def holder(client, *scopes, **limits):
    """Return the head of a request by whoever holds a new key."""
    return bearer(make(client, *scopes, **limits)["secret"])


@contextmanager
def campus_and_dock(folder, built):
    """Run a service with keys that has maps `campus`, built, and `dock`, empty."""
    data_dir = copy_of(built.data_dir, folder / "data")
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "dock"})
    with running(data_dir, admin_key=ADMIN_KEY) as client:
        yield client


@pytest.fixture(scope="module")
def client(tmp_path_factory, built):
    with campus_and_dock(tmp_path_factory.mktemp("scopes"), built) as client:
        yield client


@pytest.fixture(scope="module")
def holders(client):
    return {scope: holder(client, scope) for scope in Scope}


# Every route, every scope


def test_no_route_is_without_a_line_in_the_table():
    assert set(routes_of_the_service()) == OPENED_BY.keys() | NEED_NO_KEY


@pytest.mark.parametrize("scope", Scope)
@pytest.mark.parametrize("route", OPENED_BY)
def test_a_route_opens_for_its_scopes_and_for_no_other(client, holders, route, scope):
    method, _, path = route.partition(" ")
    asked = re.sub(r"\{(\w+)\}", lambda part: PARTS.get(part[1], "x" * 12), path)
    status, problem = ask(client, method, asked, holders[scope])
    if scope is Scope.ADMIN or scope in OPENED_BY[route]:
        assert status not in {401, 403}, problem
    else:
        assert (status, problem) == (403, "scope-missing")


def ask(client, method, path, headers):
    if method != "WS":
        response = client.request(method, path, headers=headers)
        name = problem_of(response)[1] if response.status_code >= 400 else None
        return response.status_code, name
    with (
        pytest.raises(WebSocketDenialResponse) as refused,
        client.websocket_connect(path, headers=headers),
    ):
        pass
    return refused.value.status_code, refused.value.json()["type"].removeprefix("/problems/")


def test_the_description_names_the_scopes_of_each_route(client):
    paths = client.get("/openapi.json").json()["paths"]
    for route, scopes in OPENED_BY.items():
        method, _, path = route.partition(" ")
        if method == "WS":
            continue
        told = [scope for way in paths[path][method.lower()]["security"] for scope in way.values()]
        assert sorted(told) == sorted([scope.value] for scope in scopes or {Scope.ADMIN}), route


def test_a_route_that_declares_no_scope_is_the_administrators(tmp_path):
    app = create_app(Settings(data_dir=tmp_path, admin_key=ADMIN_KEY))
    router = APIRouter(prefix="/v1", dependencies=[Depends(require_access)])

    @router.get("/forgotten")
    def forgotten() -> str:
        return "told"

    app.include_router(router)
    with Client(app) as client:
        assert client.get("/v1/forgotten", headers=ADMIN).json() == "told"
        everything_else = holder(client, READ, WRITE, LOCALIZE)
        refused = client.get("/v1/forgotten", headers=everything_else)
        assert problem_of(refused) == (403, "scope-missing")


def test_a_declaration_names_a_scope():
    with pytest.raises(ValueError, match="at least one"):
        needs()


def test_a_refusal_tells_which_scope_would_do(client, holders):
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


def test_while_keys_cannot_be_looked_up_nobody_gets_in(client, monkeypatch, caplog):
    def fail(*_):
        raise StorageUnavailable("the catalog is away")

    reader = holder(client, READ)
    monkeypatch.setattr(client.service.store.keys, "with_hash", fail)
    refused = client.get("/v1/maps", headers=reader)
    assert problem_of(refused) == (503, "storage-unavailable")
    assert "who asks" in caplog.text


def test_a_route_that_nobody_guards_is_closed(tmp_path):
    app = create_app(Settings(data_dir=tmp_path, admin_key=ADMIN_KEY))
    router = APIRouter(prefix="/v2", dependencies=[Depends(require_access)])

    @router.get("/maps", dependencies=[needs(READ)])
    def maps() -> str:
        return "told"

    app.include_router(router)
    with Client(app) as client:
        assert problem_of(client.get("/v2/maps", headers=ADMIN)) == (401, "key-needed")


# Secrets


def test_a_secret_is_shown_once_and_only_its_hash_is_kept(client):
    made = make(client, READ, maps=["campus"], expires_at="2100-01-01T00:00:00+02:00")
    key, secret = made["key"], made.pop("secret")
    assert re.fullmatch(rf"tm_{key}_[\w-]{{43}}", secret)
    assert made["scopes"] == ["maps:read"]
    assert made["in_use"] is True
    shown = client.get(f"/v1/keys/{key}", headers=ADMIN)
    assert shown.json() == {**made, "expires_at": "2099-12-31T22:00:00Z"}
    listed = client.get("/v1/keys?limit=1000", headers=ADMIN)
    assert shown.json() in listed.json()["items"]
    assert secret not in shown.text + listed.text
    for path in client.service.settings.data_dir.rglob("*"):
        assert path.is_dir() or secret.encode() not in path.read_bytes(), path


def test_the_answer_with_the_secret_is_not_to_be_cached(client):
    wanted = {"name": "x", "scopes": ["localize"]}
    made = client.post("/v1/keys", json=wanted, headers=ADMIN)
    assert made.headers["Cache-Control"] == "no-store"
    assert made.headers["Location"] == f"/v1/keys/{made.json()['key']}"


def test_the_right_id_with_another_secret_opens_nothing(client):
    one, other = make(client, READ), make(client, READ)
    mixed = f"tm_{one['key']}_{other['secret'].split('_', 2)[2]}"
    assert problem_of(client.get("/v1/maps", headers=bearer(mixed))) == (401, "key-refused")


@pytest.mark.parametrize(
    "sent",
    [
        "tm_",
        "tm__",
        "tm_x_y",
        "tm_0123456789abcdef_",
        f"tm_0123456789abcdef_{'A' * 43}",
        f"tm_0123456789abcdef_{'A' * 42}%",
        f"tm_' OR 1=1 --_{'A' * 43}",
        f"TM_0123456789abcdef_{'A' * 43}",
        "A" * 60_000,
        "\xe9\xff",
        "null",
    ],
)
def test_what_is_no_key_is_refused(client, sent):
    refused = client.get("/v1/maps", headers={"Authorization": f"Bearer {sent}".encode("latin-1")})
    assert problem_of(refused) == (401, "key-refused")


def test_the_hash_of_a_key_is_no_key(client):
    record = client.service.store.keys.get(make(client, READ)["key"])
    refused = client.get("/v1/maps", headers=bearer(record.secret_hash))
    assert problem_of(refused) == (401, "key-refused")


# Expiry and revocation


def test_a_revoked_key_opens_nothing_from_the_next_request_on(client):
    made = make(client, READ)
    headers = bearer(made["secret"])
    assert client.get("/v1/maps", headers=headers).status_code == 200
    revoked = client.delete(f"/v1/keys/{made['key']}", headers=ADMIN).json()
    assert (revoked["in_use"], revoked["revoked_at"] is None) == (False, False)
    refused = client.get("/v1/maps", headers=headers)
    assert problem_of(refused) == (401, "key-refused")
    assert "revoked" in refused.json()["detail"]
    again = client.delete(f"/v1/keys/{made['key']}", headers=ADMIN)
    assert again.json() == revoked


def test_a_key_opens_nothing_after_its_end(client):
    made = make(client, READ)
    catalog = client.service.store.catalog
    secret = f"tm_{'0' * 16}_{'B' * 43}"
    ended = datetime.now(UTC) - timedelta(seconds=1)
    catalog.keys.add(secret_hash(secret), [READ], key_id="0" * 16, expires_at=ended)
    refused = client.get("/v1/maps", headers=bearer(secret))
    assert problem_of(refused) == (401, "key-refused")
    assert "expired" in refused.json()["detail"]
    shown = client.get(f"/v1/keys/{'0' * 16}", headers=ADMIN).json()
    assert (shown["in_use"], made["in_use"]) == (False, True)


def test_a_stream_ends_when_its_key_is_revoked(client):
    made = make(client, LOCALIZE)
    headers = bearer(made["secret"])
    track = client.post("/v1/maps/campus/tracks", headers=headers).headers["Location"]
    with client.websocket_connect(f"{track}/stream", headers=headers) as stream:
        stream.send_text("{}")
        assert stream.receive_json()["type"] == "/problems/invalid-request"
        client.delete(f"/v1/keys/{made['key']}", headers=ADMIN)
        stream.send_text("{}")
        assert stream.receive_json()["type"] == "/problems/key-refused"
        with pytest.raises(WebSocketDisconnect) as closed:
            stream.receive_json()
    assert closed.value.code == 1008


def stand_still(*_):
    """Be a worker that never ends."""
    time.sleep(600)


def test_the_events_of_a_job_end_when_the_key_is_revoked(tmp_path, built, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_build", stand_still)
    with running(copy_of(built.data_dir, tmp_path / "data"), admin_key=ADMIN_KEY) as client:
        made = make(client, WRITE)
        headers = bearer(made["secret"])
        queued = client.post("/v1/maps/campus/builds", json={"segments": 2}, headers=headers)
        job, store = queued.json()["job"], client.service.store

        begun = threading.Event()

        def noting(**told):
            begun.set()
            return format_sse_event(**told)

        monkeypatch.setattr("app.job_events.format_sse_event", noting)

        def revoke_when_it_is_told():
            assert begun.wait(60)
            until(lambda: store.jobs.get(job).state == "running", "it does not run")
            store.keys.revoke(made["key"])

        revoking = threading.Thread(target=revoke_when_it_is_told)
        revoking.start()
        told = client.get(f"/v1/jobs/{job}/events", headers=headers)
        revoking.join()
        assert told.status_code == 200
        assert store.jobs.get(job).state == "running"


# What a key may not be


@pytest.mark.parametrize(
    ("wanted", "problem"),
    [
        ({"scopes": ["admin"], "maps": ["campus"]}, "invalid-parameters"),
        ({"scopes": ["localize"], "expires_at": "2001-01-01T00:00:00Z"}, "invalid-parameters"),
        ({"scopes": ["localize"], "maps": ["No Slug"]}, "invalid-slug"),
        ({"scopes": ["localize"], "expires_at": "2100-01-01T00:00:00"}, "invalid-request"),
        ({"scopes": ["localize"], "maps": []}, "invalid-request"),
        ({"scopes": []}, "invalid-request"),
        ({"scopes": ["maps"]}, "invalid-request"),
        ({"scopes": ["localize"], "name": ""}, "invalid-request"),
        ({"scopes": ["localize"], "secret": "mine"}, "invalid-request"),
    ],
)
def test_a_key_that_makes_no_sense_is_refused(client, wanted, problem):
    before = client.get("/v1/keys?limit=1000", headers=ADMIN).json()
    refused = client.post("/v1/keys", json={"name": "x", **wanted}, headers=ADMIN)
    assert problem_of(refused) == (422, problem)
    assert client.get("/v1/keys?limit=1000", headers=ADMIN).json() == before


def test_keys_are_listed_in_the_order_of_their_making(client):
    ids = [make(client, READ)["key"] for _ in range(3)]
    listed, after = [], ""
    while after is not None:
        page = client.get(f"/v1/keys?limit=7&after={after}", headers=ADMIN).json()
        listed += [key["key"] for key in page["items"]]
        after = page["next_after"]
    assert listed[-3:] == ids
    assert len(set(listed)) == len(listed)
    assert problem_of(client.get("/v1/keys?after=none", headers=ADMIN)) == (
        422,
        "invalid-parameters",
    )
    assert problem_of(client.get("/v1/keys/none", headers=ADMIN)) == (404, "key-not-found")


# From no key to the first


def test_the_first_key_is_an_administrators_and_closes_the_service(tmp_path):
    with running(tmp_path) as client:
        for scopes in (["localize"], ["maps:read", "maps:write"]):
            refused = client.post("/v1/keys", json={"name": "first", "scopes": scopes})
            assert problem_of(refused) == (422, "invalid-parameters")
        assert client.get("/v1/maps").status_code == 200
        first = client.post("/v1/keys", json={"name": "first", "scopes": ["admin"]}).json()
        assert problem_of(client.get("/v1/maps")) == (401, "key-needed")
        headers = bearer(first["secret"])
        assert client.get("/v1/maps", headers=headers).status_code == 200
        client.delete(f"/v1/keys/{first['key']}", headers=headers)
        # Without any key that opens it, it stays closed: never open by accident.
        assert problem_of(client.get("/v1/maps")) == (401, "key-needed")
    with running(tmp_path) as client:
        assert problem_of(client.get("/v1/maps")) == (401, "key-needed")
    with running(tmp_path, admin_key=ADMIN_KEY) as client:
        assert client.get("/v1/maps", headers=ADMIN).status_code == 200


def test_the_key_of_the_settings_puts_the_made_one_out_of_use_and_no_other(tmp_path, capsys):
    with running(tmp_path, host="0.0.0.0") as client:
        [shown] = re.findall(r"tm_\S+", capsys.readouterr().out)
        made = client.post(
            "/v1/keys", json={"name": "fleet", "scopes": ["maps:read"]}, headers=bearer(shown)
        ).json()["secret"]
    with running(tmp_path, admin_key=ADMIN_KEY) as client:
        refused = client.get("/v1/maps", headers=bearer(shown))
        assert problem_of(refused) == (401, "key-refused")
        assert client.get("/v1/maps", headers=bearer(made)).status_code == 200
        assert client.get("/v1/maps", headers=ADMIN).status_code == 200
