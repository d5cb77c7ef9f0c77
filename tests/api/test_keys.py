"""Keys: a secret shown once, expired or revoked; and the first key."""

import re
import threading
from datetime import UTC, datetime, timedelta

import pytest
from fastapi.sse import format_sse_event
from starlette.websockets import WebSocketDisconnect

from app.access.secrets import secret_hash
from app.drives import scan_group
from tests.support.access import (
    ADMIN,
    ADMIN_KEY,
    LOCALIZE,
    READ,
    WRITE,
    bearer,
    make,
)
from tests.support.process import until
from tests.support.recording import TAR, kitti, npy, recording, tar
from tests.support.service import copy_of, problem_of, running
from tests.support.workers import never_end


@pytest.fixture(scope="module")
def client(guarded):
    return guarded


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
    body = {"name": "x", "scopes": ["localize"]}
    made = client.post("/v1/keys", json=body, headers=ADMIN)
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
def test_an_invalid_key_is_rejected(client, sent):
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


def revoke_once_scans_are_stored(client, made, monkeypatch):
    scans = client.service.store.drives
    put = scans.put_scans

    def put_and_revoke(*args, **options):
        results = put(*args, **options)
        client.delete(f"/v1/keys/{made['key']}", headers=ADMIN)
        return results

    monkeypatch.setattr(scans, "put_scans", put_and_revoke)


def test_an_upload_ends_when_its_key_is_revoked(client, monkeypatch):
    made = make(client, WRITE)
    revoke_once_scans_are_stored(client, made, monkeypatch)
    monkeypatch.setattr(scan_group, "_GROUP_SCANS", 2)
    path = "/v1/maps/campus/drives/cut-short/scans"
    files = [(f"{i:06}.npy", npy(scan.points_m)) for i, scan in enumerate(recording().scans[:6])]
    refused = client.post(path, content=tar(files), headers={**bearer(made["secret"]), **TAR})
    assert problem_of(refused) == (401, "key-refused")
    assert "revoked" in refused.json()["detail"]
    assert refused.headers["WWW-Authenticate"] == 'Bearer error="invalid_token"'
    assert client.get(path, headers=ADMIN).json()["scans"] == 2


def test_poses_of_an_upload_are_not_set_once_its_key_is_revoked(client, monkeypatch):
    made = make(client, WRITE)
    revoke_once_scans_are_stored(client, made, monkeypatch)
    drive = "/v1/maps/campus/drives/without-poses"
    files = [
        ("velodyne/000000.bin", kitti(recording().scans[0])),
        ("poses.txt", b"1 0 0 7 0 1 0 0 0 0 1 0\n"),
    ]
    headers = {**bearer(made["secret"]), **TAR}
    refused = client.post(f"{drive}/scans", content=tar(files), headers=headers)
    assert problem_of(refused) == (401, "key-refused")
    shown = client.get(f"{drive}/scans", headers=ADMIN).json()
    assert (shown["scans"], shown["scans_with_pose"]) == (1, 0)


def test_the_events_of_a_job_end_when_the_key_is_revoked(tmp_path, built, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    with running(copy_of(built.data_dir, tmp_path / "data"), admin_key=ADMIN_KEY) as client:
        made = make(client, WRITE)
        headers = bearer(made["secret"])
        queued = client.post("/v1/maps/campus/builds", json={"segments": 2}, headers=headers)
        job, store = queued.json()["job"], client.service.store

        begun = threading.Event()

        def noting(**event):
            begun.set()
            return format_sse_event(**event)

        monkeypatch.setattr("app.jobs.events.format_sse_event", noting)

        def revoke_when_it_runs():
            assert begun.wait(60)
            until(lambda: store.jobs.get(job).state == "running", "it does not run")
            store.keys.revoke(made["key"])

        revoking = threading.Thread(target=revoke_when_it_runs)
        revoking.start()
        response = client.get(f"/v1/jobs/{job}/events", headers=headers)
        revoking.join()
        assert response.status_code == 200
        assert store.jobs.get(job).state == "running"


# What a key may not be


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ({"scopes": ["admin"], "maps": ["campus"]}, "invalid-parameters"),
        ({"scopes": ["localize", "metrics"], "maps": ["campus"]}, "invalid-parameters"),
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
def test_an_invalid_key_request_is_rejected(client, body, problem):
    before = client.get("/v1/keys?limit=1000", headers=ADMIN).json()
    refused = client.post("/v1/keys", json={"name": "x", **body}, headers=ADMIN)
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
        listed = client.get("/v1/keys", headers=ADMIN).json()["items"]
        assert [key["in_use"] for key in listed] == [False, True]
