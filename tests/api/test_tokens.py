"""Tokens: a key is exchanged for one, with no more rights and no longer life."""

from datetime import UTC, datetime, timedelta

import pytest

from app.access.scopes import Scope
from app.access.secrets import secret_hash
from tests.support.access import ADMIN, ADMIN_KEY, bearer, holder, make
from tests.support.service import problem_of, running


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    with running(tmp_path_factory.mktemp("tokens") / "data", admin_key=ADMIN_KEY) as client:
        for slug in ("campus", "dock"):
            client.post("/v1/maps", json={"map": slug}, headers=ADMIN)
        yield client


def exchange(client, headers, **body):
    exchanged = client.post("/v1/tokens", json=body, headers=headers)
    assert exchanged.status_code == 201, exchanged.text
    return exchanged.json()


def test_a_token_opens_what_its_key_opens_for_an_hour_at_most(client):
    made = make(client, "maps:read", "localize", maps=["campus"])
    before = datetime.now(UTC)
    answer = client.post("/v1/tokens", json={}, headers=bearer(made["secret"]))
    token = answer.json()
    assert answer.headers["Cache-Control"] == "no-store"
    assert token["key"] == made["key"]
    assert (token["scopes"], token["maps"]) == (["localize", "maps:read"], ["campus"])
    assert token["secret"].startswith(f"tmt_{token['token']}_")
    ends = datetime.fromisoformat(token["expires_at"])
    assert before < ends <= datetime.now(UTC) + timedelta(hours=1)
    headers = bearer(token["secret"])
    assert [m["map"] for m in client.get("/v1/maps", headers=headers).json()["items"]] == ["campus"]
    assert problem_of(client.get("/v1/maps/dock", headers=headers)) == (404, "map-not-found")
    refused = client.post("/v1/maps", json={"map": "campus"}, headers=headers)
    assert problem_of(refused) == (403, "scope-missing")
    assert "token of key" in refused.json()["detail"]
    for path in client.service.settings.data_dir.rglob("*"):
        assert path.is_dir() or token["secret"].encode() not in path.read_bytes(), path


def test_a_token_may_be_narrower_than_its_key(client):
    key = holder(client, "maps:read", "localize")
    token = exchange(client, key, scopes=["localize"], maps=["dock"], expires_in_s=60)
    headers = bearer(token["secret"])
    assert problem_of(client.get("/v1/maps", headers=headers)) == (403, "scope-missing")
    for slug, problem in (("dock", (409, "no-live-revision")), ("campus", (404, "map-not-found"))):
        requested = client.get(f"/v1/maps/{slug}/basis", headers=headers)
        assert problem_of(requested) == problem
    left_s = datetime.fromisoformat(token["expires_at"]) - datetime.now(UTC)
    assert left_s <= timedelta(seconds=60)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ({"scopes": ["maps:write"]}, (403, "scope-missing")),
        ({"scopes": ["localize", "maps:write"]}, (403, "scope-missing")),
        ({"maps": ["dock"]}, (403, "scope-missing")),
        ({"maps": ["campus", "dock"]}, (403, "scope-missing")),
        ({"maps": ["nowhere"]}, (403, "scope-missing")),
        ({"scopes": ["admin"]}, (422, "invalid-parameters")),
        ({"maps": ["No Slug"]}, (422, "invalid-slug")),
        ({"maps": []}, (422, "invalid-request")),
        ({"scopes": []}, (422, "invalid-request")),
        ({"expires_in_s": 3601}, (422, "invalid-request")),
        ({"expires_in_s": 59}, (422, "invalid-request")),
        ({"key": "other"}, (422, "invalid-request")),
    ],
)
def test_a_token_is_never_wider_than_its_key_nor_longer_than_an_hour(client, body, problem):
    key = holder(client, "localize", maps=["campus"])
    assert problem_of(client.post("/v1/tokens", json=body, headers=key)) == problem


def test_a_token_never_administers_nor_reads_metrics_not_even_an_administrators(client):
    for administrator in (ADMIN, holder(client, "admin")):
        token = exchange(client, administrator)
        assert set(token["scopes"]) == set(Scope) - {Scope.ADMIN, Scope.METRICS}
        headers = bearer(token["secret"])
        assert problem_of(client.get("/v1/keys", headers=headers)) == (403, "scope-missing")
        for scope in ("admin", "metrics"):
            refused = client.post("/v1/tokens", json={"scopes": [scope]}, headers=administrator)
            assert problem_of(refused) == (422, "invalid-parameters")


def test_a_token_is_exchanged_for_no_other(client):
    token = exchange(client, holder(client, "localize"))
    refused = client.post("/v1/tokens", json={}, headers=bearer(token["secret"]))
    assert problem_of(refused) == (403, "scope-missing")


def test_a_token_ends_with_its_key(client):
    made = make(client, "maps:read")
    headers = bearer(exchange(client, bearer(made["secret"]))["secret"])
    assert client.get("/v1/maps", headers=headers).status_code == 200
    client.delete(f"/v1/keys/{made['key']}", headers=ADMIN)
    assert problem_of(client.get("/v1/maps", headers=headers)) == (401, "key-refused")


def test_a_token_ends_by_itself_and_is_cleared_away(client):
    tokens = client.service.store.tokens
    key = make(client, "maps:read")
    secret = f"tmt_{'1' * 16}_{'C' * 43}"
    ended = datetime.now(UTC) - timedelta(seconds=1)
    key_hash = secret_hash(key["secret"])
    tokens.add("1" * 16, secret_hash(secret), key_hash, ["maps:read"], None, ended, most=1)
    refused = client.get("/v1/maps", headers=bearer(secret))
    assert problem_of(refused) == (401, "key-refused")
    assert "expired" in refused.json()["detail"]
    exchange(client, bearer(key["secret"]))
    make(client, "maps:read")  # now what is kept in memory is read again
    assert tokens.with_hash(secret_hash(secret)) is None
    assert problem_of(client.get("/v1/maps", headers=bearer(secret))) == (401, "key-refused")


def test_another_secret_with_a_tokens_id_or_kind_opens_nothing(client):
    key = make(client, "maps:read")
    token = exchange(client, bearer(key["secret"]))
    guessed = f"tmt_{token['token']}_{'D' * 43}"
    as_key = token["secret"].replace("tmt_", "tm_", 1)
    as_token = key["secret"].replace("tm_", "tmt_", 1)
    for sent in (guessed, as_key, as_token):
        assert problem_of(client.get("/v1/maps", headers=bearer(sent))) == (401, "key-refused")


def test_a_token_counts_and_signs_as_its_key(tmp_path):
    limits = {"requests_per_s": 0.001, "request_burst": 4}
    with running(tmp_path, admin_key=ADMIN_KEY, **limits) as client:
        made = make(client, "maps:write")
        key = bearer(made["secret"])
        token = bearer(exchange(client, key)["secret"])
        client.post("/v1/maps", json={"map": "campus"}, headers=token)
        answer = client.get("/v1/jobs", headers=token)
        assert answer.headers["RateLimit"].startswith('"requests";r=1;')
        shown = client.get(f"/v1/audit?key={made['key']}", headers=ADMIN).json()["items"]
    assert [entry["action"] for entry in shown] == ["exchange_token", "create_map"]


def test_a_key_has_as_many_valid_tokens_as_it_may(tmp_path):
    with running(tmp_path, admin_key=ADMIN_KEY, max_tokens_per_key=2) as client:
        fleet, other = make(client, "localize"), holder(client, "localize")
        key = bearer(fleet["secret"])
        exchange(client, key)
        used = bearer(exchange(client, key)["secret"])
        refused = client.post("/v1/tokens", json={}, headers=key)
        assert problem_of(refused) == (429, "too-many-tokens")
        assert "the limit of 2 valid tokens of a key is reached" in refused.json()["detail"]
        assert client.get("/v1/bases", headers=used).status_code == 200
        exchange(client, other)
        exchange(client, ADMIN)


def test_tokens_of_the_key_of_the_settings_end_when_it_is_changed(tmp_path):
    with running(tmp_path, admin_key=ADMIN_KEY) as client:
        token = bearer(exchange(client, ADMIN)["secret"])
    for key, status in ((ADMIN_KEY, 200), ("another key of the operator", 401)):
        with running(tmp_path, admin_key=key) as client:
            assert client.get("/v1/maps", headers=token).status_code == status
    with running(tmp_path) as client:
        client.post("/v1/keys", json={"name": "first", "scopes": ["admin"]})
        assert problem_of(client.get("/v1/maps", headers=token)) == (401, "key-refused")


def test_a_service_without_keys_has_nothing_to_exchange(tmp_path):
    with running(tmp_path) as client:
        assert problem_of(client.post("/v1/tokens", json={})) == (401, "key-needed")
