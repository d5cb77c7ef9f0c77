"""Keys for tests, and the scopes that each route of the service needs."""

import pytest
from starlette.testclient import WebSocketDenialResponse

from app.access.scopes import Scope
from tests.support.service import problem_of

ADMIN_KEY = "correct horse battery staple"
READ, WRITE, LOCALIZE = Scope.MAPS_READ, Scope.MAPS_WRITE, Scope.LOCALIZE
METRICS = Scope.METRICS

OPENED_BY = {
    "GET /v1/maps": {READ},
    "POST /v1/maps": {WRITE},
    "GET /v1/maps/{map}": {READ},
    "PATCH /v1/maps/{map}": {WRITE},
    "DELETE /v1/maps/{map}": {WRITE},
    "POST /v1/maps/{map}/anchor": {WRITE},
    "GET /v1/recycle-bin": {READ, WRITE},
    "POST /v1/recycle-bin/{entry}/restore": {WRITE},
    "DELETE /v1/recycle-bin/{entry}": set(),
    "GET /v1/maps/{map}/drives": {READ, WRITE},
    "GET /v1/maps/{map}/drives/{drive}": {READ, WRITE},
    "PUT /v1/maps/{map}/drives/{drive}": {WRITE},
    "PATCH /v1/maps/{map}/drives/{drive}": {WRITE},
    "DELETE /v1/maps/{map}/drives/{drive}": {WRITE},
    "GET /v1/maps/{map}/drives/{drive}/scans": {READ, WRITE},
    "POST /v1/maps/{map}/drives/{drive}/scans": {WRITE},
    "GET /v1/maps/{map}/drives/{drive}/scans/{index}": {READ},
    "PUT /v1/maps/{map}/drives/{drive}/scans/{index}": {WRITE},
    "GET /v1/maps/{map}/drives/{drive}/poses": {READ},
    "PUT /v1/maps/{map}/drives/{drive}/poses": {WRITE},
    "GET /v1/maps/{map}/captures": {READ, WRITE},
    "POST /v1/maps/{map}/drives/{drive}/captures": {WRITE},
    "GET /v1/maps/{map}/drives/{drive}/captures": {READ, WRITE},
    "GET /v1/maps/{map}/drives/{drive}/captures/{capture}": {READ, WRITE},
    "PATCH /v1/maps/{map}/drives/{drive}/captures/{capture}": {WRITE},
    "DELETE /v1/maps/{map}/drives/{drive}/captures/{capture}": {WRITE},
    "PUT /v1/maps/{map}/drives/{drive}/captures/{capture}/parts/{part}": {WRITE},
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
    "GET /v1/maps/{map}/geojson": {READ},
    "GET /v1/maps/{map}/topology": {READ},
    "POST /v1/bases": {WRITE},
    "GET /v1/bases": {READ, LOCALIZE},
    "GET /v1/bases/{basis}": {READ, LOCALIZE},
    "DELETE /v1/bases/{basis}": {WRITE},
    "POST /v1/localizations/signature": {LOCALIZE},
    "POST /v1/localizations/scan": {LOCALIZE},
    "POST /v1/maps/{map}/localizations/scan": {LOCALIZE},
    "POST /v1/maps/{map}/localizations/image": {LOCALIZE},
    "POST /v1/maps/{map}/localizations/signature": {LOCALIZE},
    "POST /v1/maps/{map}/localizations/batch": {LOCALIZE},
    "POST /v1/maps/{map}/loop-closures": {LOCALIZE},
    "POST /v1/maps/{map}/tracks": {LOCALIZE},
    "GET /v1/maps/{map}/tracks": {LOCALIZE},
    "GET /v1/maps/{map}/tracks/{track}": {LOCALIZE},
    "DELETE /v1/maps/{map}/tracks/{track}": {LOCALIZE},
    "POST /v1/maps/{map}/tracks/{track}/observations": {LOCALIZE},
    "GET /v1/maps/{map}/tracks/{track}/stream": {LOCALIZE},
    "WS /v1/maps/{map}/tracks/{track}/stream": {LOCALIZE},
    "POST /v1/keys": set(),
    "GET /v1/keys": set(),
    "GET /v1/keys/{key}": set(),
    "DELETE /v1/keys/{key}": set(),
    "GET /v1/audit": set(),
    "GET /metrics": {METRICS},
    "POST /v1/tokens": {READ, WRITE, LOCALIZE},
}
"""Which scopes open a route, besides `admin`, which opens all."""


def bearer(secret):
    return {"Authorization": f"Bearer {secret}"}


ADMIN = bearer(ADMIN_KEY)


def make(client, *scopes, **limits):
    body = {"name": "a test's", "scopes": list(scopes), **limits}
    made = client.post("/v1/keys", json=body, headers=ADMIN)
    assert made.status_code == 201, made.text
    return made.json()


def holder(client, *scopes, **limits):
    """Return the head of a request with a new key."""
    return bearer(make(client, *scopes, **limits)["secret"])


def send(client, method, path, headers):
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
