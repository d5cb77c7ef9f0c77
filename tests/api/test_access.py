"""Authentication: this machine under its own names, or holders of keys."""

import re

import pytest
from starlette.requests import HTTPConnection

from app.main import create_app
from app.settings import Settings
from storage.catalog import EVERYONE_ID
from tests.support.service import Client, document, problem_of, running

KEY = "correct horse battery staple"
PARTS = {"index": "0"}


ROUTES = [
    (method.upper(), re.sub(r"\{(\w+)\}", lambda part: PARTS.get(part[1], "x" * 12), path))
    for path, methods in document()["paths"].items()
    for method in methods
]
BEHIND_THE_KEY = [route for route in ROUTES if route[1].startswith(("/v1/", "/metrics"))]
OPEN = [route for route in ROUTES if route not in BEHIND_THE_KEY]


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    with running(tmp_path_factory.mktemp("locked"), admin_key=KEY) as client:
        yield client


def bearer(key):
    return {"Authorization": f"Bearer {key}"}


def test_the_api_has_routes():
    assert len(BEHIND_THE_KEY) > 20
    assert {path for _, path in OPEN} >= {"/livez", "/readyz", "/version"}


@pytest.mark.parametrize(("method", "path"), BEHIND_THE_KEY)
def test_no_route_of_the_api_nor_the_metrics_answer_without_the_key(locked, method, path):
    for headers in ({}, {"Authorization": f"Basic {KEY}"}, {"Authorization": KEY}, bearer("")):
        refused = locked.request(method, path, headers=headers)
        assert problem_of(refused) == (401, "key-needed")
        assert refused.headers["WWW-Authenticate"] == "Bearer"
    wrong = locked.request(method, path, headers=bearer(f"{KEY}x"))
    assert problem_of(wrong) == (401, "key-refused")
    assert wrong.headers["WWW-Authenticate"] == 'Bearer error="invalid_token"'
    right = locked.request(method, path, headers=bearer(KEY))
    assert right.status_code != 401


@pytest.mark.parametrize(
    "path", [*(path for _, path in OPEN if "problems" not in path), "/docs", "/openapi.json"]
)
def test_health_and_documentation_need_no_key(locked, path):
    assert locked.get(path).status_code == 200


def test_with_a_key_the_name_of_the_host_does_not_matter(tmp_path):
    settings = Settings(data_dir=tmp_path, admin_key=KEY)
    with Client(create_app(settings), base_url="https://maps.example") as client:
        assert client.get("/v1/maps", headers=bearer(KEY)).status_code == 200


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "127.0.0.1:8000", "localhost", "localhost:8000", "[::1]:8000"]
)
def test_without_keys_this_machine_is_answered_by_its_own_names(client, host):
    assert client.get("/v1/maps", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    ["maps.example", "127.0.0.1.maps.example", "localhost.maps.example", "0.0.0.0", "10.1.2.3"],
)
def test_without_keys_a_name_that_a_foreign_page_chose_is_refused(client, host):
    refused = client.get("/v1/maps", headers={"Host": host})
    assert problem_of(refused) == (421, "host-not-allowed")


@pytest.mark.parametrize(
    "host",
    [
        "",
        "[",
        "[::1",
        "a b",
        "@",
        "127.0.0.1@maps.example",
        "x:99999",
        "a{b}.example",
        "a`b.example",
    ],
)
def test_without_keys_an_invalid_host_is_refused_too(client, host):
    refused = client.get("/v1/maps", headers={"Host": host})
    assert problem_of(refused) == (421, "host-not-allowed")


@pytest.mark.parametrize("field", ["X-Forwarded-For", "Forwarded"])
def test_without_keys_a_proxy_on_this_machine_gets_no_answer_under_this_machines_name(
    client, field
):
    # nginx sends the name that its client sent, or that of its `proxy_pass`.
    headers = {"Host": "localhost", field: "192.0.2.7"}
    refused = client.get("/v1/maps", headers=headers)
    assert problem_of(refused) == (421, "host-not-allowed")
    assert "through a proxy" in refused.json()["detail"]


def test_without_keys_a_request_that_names_no_host_is_answered(client):
    server = ("127.0.0.1", 8000)
    scope = {"type": "http", "method": "GET", "path": "/", "server": server, "headers": []}
    caller = client.service.access.caller_of(HTTPConnection(scope))
    assert caller.key_id == EVERYONE_ID


def test_without_keys_another_address_of_this_machine_is_refused(tmp_path):
    # As if `uvicorn --host 0.0.0.0` listened although the settings name loopback.
    app = create_app(Settings(data_dir=tmp_path))
    with Client(app, base_url="http://192.0.2.7") as client:
        forged = client.get("/v1/maps", headers={"Host": "localhost"})
        assert problem_of(forged) == (421, "host-not-allowed")


def test_on_an_open_address_a_key_is_made_shown_once_and_never_kept(tmp_path, capsys):
    with running(tmp_path, host="0.0.0.0") as client:
        shown = capsys.readouterr().out
        [key] = re.findall(r"tm_\S+", shown)
        assert problem_of(client.get("/v1/maps")) == (401, "key-needed")
        assert client.get("/v1/maps", headers=bearer(key)).status_code == 200
        for path in tmp_path.rglob("*"):
            assert path.is_dir() or key.encode() not in path.read_bytes(), path
    for host in ("0.0.0.0", "127.0.0.1"):
        with running(tmp_path, host=host) as client:
            assert capsys.readouterr().out == ""
            assert problem_of(client.get("/v1/maps")) == (401, "key-needed")
            assert client.get("/v1/maps", headers=bearer(key)).status_code == 200


def test_a_key_that_is_short_is_refused_at_the_start():
    with pytest.raises(ValueError, match="at least 16"):
        Settings(admin_key="short")


@pytest.mark.parametrize(
    "key",
    [
        "correct-horse-battery ",
        " correct-horse-battery",
        "schlüssel-der-verwaltung",
        "correct-horse\tbattery",
        "correct-horse-battery\n",
    ],
)
def test_a_key_that_no_request_can_send_is_refused_at_the_start_and_not_shown(key):
    with pytest.raises(ValueError, match="wanted printable ASCII") as refused:
        Settings(admin_key=key)
    assert key not in str(refused.value)


def test_a_key_of_several_words_is_one(tmp_path):
    with running(tmp_path, admin_key="correct horse battery staple") as client:
        answer = client.get("/v1/maps", headers=bearer("correct horse battery staple"))
    assert answer.status_code == 200
