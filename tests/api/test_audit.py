"""The audit log over HTTP: every change has its entry, and the chain shows a missing one."""

import asyncio
import logging
import re
import sqlite3
from contextlib import closing
from pathlib import Path
from unittest.mock import Mock
from urllib.parse import quote

import pytest
from starlette.requests import ClientDisconnect
from starlette.testclient import TestClient
from typer.testing import CliRunner

from app.access.actions import RETIRED, Action
from app.access.audit_routes import Order
from app.access.scopes import Scope, needed_by
from app.cli.main import cli
from app.http.logs import LineFormatter
from app.settings import LogFormat
from storage.errors import StorageFull
from tests.support.access import ADMIN, ADMIN_KEY, bearer, holder, make
from tests.support.capture_uploads import read
from tests.support.captures import hdl32, pcap, udp
from tests.support.recording import KITTI, TAR, kitti, recording, tar
from tests.support.service import problem_of, running, upload, wait_for
from tests.support.workers import never_end


@pytest.fixture
def client(tmp_path):
    with running(tmp_path / "data", admin_key=ADMIN_KEY) as client:
        yield client


def entries(client, query=""):
    return client.get(f"/v1/audit?limit=1000&{query}", headers=ADMIN).json()["items"]


def in_short(entry):
    return entry["key"], entry["action"], entry["map"], entry["outcome"]


def test_every_change_is_logged_with_its_key_and_no_reading_request_is(client):
    made = make(client, "maps:read", "maps:write", "localize")
    fleet = bearer(made["secret"])
    client.post("/v1/maps", json={"map": "campus"}, headers=fleet)
    scan = {"content": kitti(recording().scans[0]), "headers": {**KITTI, **fleet}}
    client.put("/v1/maps/campus/drives/monday/scans/0", **scan)
    client.put("/v1/maps/campus/drives/monday/scans/0", **scan)  # changes nothing
    client.get("/v1/maps", headers=fleet)
    client.post("/v1/maps/campus/localizations/scan", **scan)
    client.patch("/v1/maps/campus", json={"description": "x"}, headers=ADMIN)
    client.delete("/v1/maps/campus", headers=fleet)
    key = made["key"]
    answer = entries(client)
    assert [in_short(entry) for entry in answer] == [
        ("operator", "make_key", None, "done"),
        (key, "create_map", "campus", "done"),
        (key, "put_scan", "campus", "done"),
        ("operator", "update_map", "campus", "done"),
        (key, "delete_map", "campus", "done"),
    ]
    assert answer[0]["detail"] == f"key {key}: localize, maps:read, maps:write of all maps"
    assert answer[2]["subject"] == "/v1/maps/campus/drives/monday/scans/0"
    assert made["secret"] not in str(answer)
    assert [entry["entry"] for entry in entries(client, f"key={key}&map=campus")] == [2, 3, 5]
    assert entries(client, f"since={answer[3]['at'].replace('+', '%2B')}")[-2:] == answer[3:]
    assert entries(client, "until=2020-01-01T00:00:00Z") == []


def test_a_change_that_is_requested_again_and_changes_nothing_has_one_entry(client):
    key = make(client, "localize")["key"]
    client.post("/v1/maps", json={"map": "campus"}, headers=ADMIN)
    drive = "/v1/maps/campus/drives/monday"
    changes = {"description": "north", "retention": {"retained_revisions": 3}}
    for _ in range(3):
        for method, path, sent in (
            ("PATCH", "/v1/maps/campus", changes),
            ("PATCH", "/v1/maps/campus", {"description": "north"}),
            ("PUT", drive, {"mounting": {"x_m": 0.0, "y_m": 0.0, "z_m": 1.8}}),
            ("PATCH", drive, {"closed": True}),
            ("DELETE", f"/v1/keys/{key}", None),
        ):
            changed = client.request(method, path, json=sent, headers=ADMIN)
            assert changed.is_success, changed.text
    assert [entry["action"] for entry in entries(client)] == [
        *("make_key", "create_map"),
        *("update_map", "put_drive", "close_drive", "revoke_key"),
    ]


def test_a_cancelled_job_is_among_the_changes_of_its_map(client, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    client.post("/v1/maps", json={"map": "campus"}, headers=ADMIN)
    scan = {"content": kitti(recording().scans[0]), "headers": {**KITTI, **ADMIN}}
    client.put("/v1/maps/campus/drives/monday/scans/0", **scan)
    wanted = {"encoding": "paper", "segments": 1}
    job = client.post("/v1/maps/campus/builds", json=wanted, headers=ADMIN).json()["job"]
    client.delete(f"/v1/jobs/{job}", headers=ADMIN)
    *_, cancelled = entries(client, "map=campus")
    assert in_short(cancelled) == ("operator", "cancel_job", "campus", "done")
    assert (cancelled["subject"], cancelled["detail"]) == (f"/v1/jobs/{job}", "build")


def test_a_key_or_token_in_a_path_is_not_in_the_log(client):
    secrets = [make(client, "localize")["secret"]]
    token = client.post("/v1/tokens", json={"scopes": ["localize"]}, headers=bearer(secrets[0]))
    secrets.append(token.json()["secret"])
    assert [secret.partition("_")[0] for secret in secrets] == ["tm", "tmt"]
    for secret in secrets:
        client.delete(f"/v1/maps/{secret}", headers=ADMIN)
    for prefix, secret, answer in zip(("tm", "tmt"), secrets, entries(client)[-2:], strict=True):
        assert answer["subject"] == f"/v1/maps/{prefix}_(hidden)"
        assert secret.split("_", 2)[2] not in str(entries(client))


@pytest.mark.parametrize("key", [ADMIN_KEY, "0123456789abcdef" * 4, "a b c?d%e'f\"g&h;i+j"])
def test_the_administrators_key_in_a_path_is_not_in_the_log_for_good(tmp_path, key, caplog):
    caplog.set_level(logging.INFO, "tensormap")
    with running(tmp_path / "data", admin_key=key) as client:
        assert client.delete(f"/v1/maps/{quote(key)}", headers=bearer(key)).status_code == 404
        entry = client.get("/v1/audit", headers=bearer(key)).json()["items"][-1]
    assert entry["subject"] == "/v1/maps/(hidden)"
    assert entry["map"] is None
    formatter = LineFormatter(LogFormat.TEXT)
    lines = "".join(formatter.format(record) for record in caplog.records)
    assert "/v1/maps/(hidden)" in lines
    assert key not in lines
    assert quote(key) not in lines


def test_what_is_refused_to_a_key_is_there_and_what_comes_without_one_is_not(client):
    reader = holder(client, "maps:read")
    client.post("/v1/maps", json={"map": "campus"}, headers=reader)
    client.delete("/v1/maps/nowhere", headers=ADMIN)
    client.post("/v1/maps", json={"map": "campus"}, headers=bearer("x" * 50))
    client.post("/v1/maps", json={"map": "campus"})
    assert [(e["action"], e["map"], e["outcome"]) for e in entries(client)[1:]] == [
        ("create_map", None, "403"),
        ("delete_map", "nowhere", "404"),
    ]


def test_what_an_incomplete_upload_stored_is_there_beside_its_failure(client):
    client.post("/v1/maps", json={"map": "campus"}, headers=ADMIN)
    files = [(f"{index:06}.bin", kitti(recording().scans[index])) for index in (0, 1)]
    whole = tar(files)
    body = whole[: whole.index(b"000001.bin") + 700]
    scans = "/v1/maps/campus/drives/monday/scans"
    cut = client.post(scans, content=body, headers={**TAR, **ADMIN}, params={"format": "kitti"})
    assert problem_of(cut) == (422, "malformed-upload")
    assert [(e["action"], e["outcome"]) for e in entries(client)[1:]] == [
        ("post_scans", "done"),
        ("post_scans", "422"),
    ]


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [
        (ZeroDivisionError(), "500"),
        (asyncio.CancelledError(), "503"),  # as at the end of a stop
        (ClientDisconnect(), "499"),
    ],
)
def test_the_outcome_of_a_request_that_did_not_end_is_there_as_in_the_servers_log(
    client, monkeypatch, caplog, fault, outcome
):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(client.service.store.maps, "delete", Mock(side_effect=fault))
    TestClient.request(client, "DELETE", "/v1/maps/campus", headers=ADMIN)
    assert in_short(entries(client)[-1]) == ("operator", "delete_map", "campus", outcome)
    [line] = [r for r in caplog.records if r.name == "tensormap.requests"][-2:-1]
    assert line.tensormap_fields["status"] == int(outcome)


def test_a_key_that_is_refused_in_a_loop_does_not_fill_the_log(client):
    made = make(client, "maps:read", "localize")
    reader = bearer(made["secret"])
    for _ in range(120):
        assert client.delete("/v1/maps/campus", headers=reader).status_code == 403
    assert 100 <= len(entries(client, f"key={made['key']}")) < 110  # one a minute is added
    client.post("/v1/tokens", json={}, headers=reader)
    client.delete("/v1/maps/nowhere", headers=ADMIN)
    assert [(e["action"], e["outcome"]) for e in entries(client)[-2:]] == [
        ("exchange_token", "done"),
        ("delete_map", "404"),
    ]


def test_what_a_build_published_is_there_as_the_services(client):
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    upload(client, "monday", recording())
    job = client.post("/v1/maps/campus/builds", json={"segments": 3, "encoding": "paper"}).json()[
        "job"
    ]
    revision = wait_for(client, job)["revision"]
    [entry] = entries(client, "key=service")
    assert in_short(entry) == ("service", "publish_revision", "campus", "done")
    published = f"revision {revision}, made live"  # the first of its map
    assert (entry["subject"], entry["detail"]) == (f"/v1/jobs/{job}", published)
    client.put("/v1/maps/campus/live", json={"revision": revision})
    assert entries(client)[-1]["detail"] == f"revision {revision}"


@pytest.mark.parametrize(
    ("wanted", "said"),
    [({}, ""), ({"make_live": True, "force": True}, ", with force, made live")],
)
def test_whether_a_build_changed_the_live_revision_is_there(client, wanted, said):
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    upload(client, "monday", recording())
    for parameters in ({"segments": 3}, {"segments": 2, **wanted}):
        sent = {"encoding": "paper", **parameters}
        job = client.post("/v1/maps/campus/builds", json=sent).json()["job"]
        revision = wait_for(client, job)["revision"]
    assert entries(client, "key=service")[-1]["detail"] == f"revision {revision}{said}"


def test_a_job_that_had_ended_is_not_there_as_cancelled(client, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    upload(client, "monday", recording(scans=1))
    job = client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
    for _ in range(3):
        assert client.delete(f"/v1/jobs/{job}").status_code == 200
        wait_for(client, job)
    assert [entry["action"] for entry in entries(client)].count("cancel_job") == 1


def test_scans_that_a_capture_became_are_there_once_as_the_services(client):
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    content = pcap([frame for payload in hdl32(turns=3.2) for frame in udp(payload, 2368)])
    (job, capture), (again, _) = (read(client, content, "monday.pcap") for _ in range(2))
    assert (job["state"], again["state"]) == ("done", "done")
    [entry] = entries(client, "key=service")  # the second one brought no scan
    assert in_short(entry) == ("service", "read_capture", "campus", "done")
    assert entry["subject"] == f"/v1/jobs/{job['job']}"
    assert entry["detail"] == f"capture {capture['capture']} into drive monday"


def test_the_key_that_a_service_makes_at_its_start_is_there_without_its_secret(tmp_path, capsys):
    with running(tmp_path, host="0.0.0.0") as client:
        [made] = re.findall(r"tm_\S+", capsys.readouterr().out)
        [entry] = client.get("/v1/audit", headers=bearer(made)).json()["items"]
    assert in_short(entry) == ("service", "make_key", None, "done")
    assert entry["detail"] == f"key {made.split('_')[1]}: admin of all maps"


def test_all_that_one_request_changes_of_a_map_is_in_its_entry(client):
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    anchor = {"latitude_deg": 49.01, "longitude_deg": 8.4}
    client.patch("/v1/maps/campus", json={"retention": {"raw_scans": "drop"}, "anchor": anchor})
    detail = entries(client)[-1]["detail"]
    assert "raw_scans=drop" in detail
    assert "latitude_deg=49.01" in detail


def test_the_new_name_of_what_is_restored_is_in_its_entry(client):
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    client.delete("/v1/maps/campus")
    [deleted] = client.get("/v1/recycle-bin").json()["items"]
    client.post(f"/v1/recycle-bin/{deleted['entry']}/restore?name=yard")
    assert entries(client)[-1]["detail"] == "map campus as yard"


def test_a_new_name_that_a_command_gives_is_there_too(client, tmp_path):
    client.headers.update(ADMIN)
    client.post("/v1/maps", json={"map": "campus"})
    client.delete("/v1/maps/campus")
    [deleted] = client.get("/v1/recycle-bin").json()["items"]
    restore = ["recycle-bin", "restore", deleted["entry"], "--name", "yard"]
    assert CliRunner().invoke(cli, [*restore, "--data", str(tmp_path / "data")]).exit_code == 0
    assert entries(client)[-1]["detail"] == "map campus as yard"


def test_a_change_that_cannot_be_written_down_is_not_made(client, monkeypatch):
    def full(*_):
        raise StorageFull("no space is left")

    monkeypatch.setattr("storage.catalog.audit_chain.append", full)
    monkeypatch.setattr("storage.catalog.audit.append", full)
    refused = client.post("/v1/maps", json={"map": "campus"}, headers=ADMIN)
    assert problem_of(refused) == (507, "storage-full")
    monkeypatch.undo()
    assert client.get("/v1/maps", headers=ADMIN).json()["items"] == []


def test_a_service_without_keys_writes_down_that_everyone_could(tmp_path):
    with running(tmp_path) as client:
        client.post("/v1/maps", json={"map": "campus"})
        [entry] = client.get("/v1/audit").json()["items"]
    assert in_short(entry) == ("everyone", "create_map", "campus", "done")


def test_an_invalid_audit_query_is_rejected(client):
    zoneless = "since=2020-01-01T00:00:00"
    for query in ("after=x", "after=-1", f"after={2**63}", "limit=0", zoneless, "since=x"):
        refused = client.get(f"/v1/audit?{query}", headers=ADMIN)
        assert problem_of(refused) == (422, "invalid-request"), query


@pytest.mark.parametrize(
    "query", ["map=Campus", "map=/v1/maps/campus", "map=", "key=ab-12", "key="]
)
def test_a_name_that_no_entry_can_have_is_refused_since_an_empty_list_says_nothing_changed(
    client, query
):
    refused = client.get(f"/v1/audit?{query}", headers=ADMIN)
    assert problem_of(refused) == (422, "invalid-request")
    assert refused.json()["errors"][0]["where"] == f"query/{query[:3]}"


def test_entries_are_filtered_by_actions_and_listed_in_either_order(client):
    for slug in ("one", "two"):
        client.post("/v1/maps", json={"map": slug}, headers=ADMIN)
        client.delete(f"/v1/maps/{slug}", headers=ADMIN)
    made = entries(client, "action=create_map")
    assert [entry["map"] for entry in made] == ["one", "two"]
    newest = entries(client, "action=delete_map&action=create_map&map=two&order=newest")
    assert [entry["action"] for entry in newest] == ["delete_map", "create_map"]
    assert entries(client, "action=revoke_key&order=newest") == []
    assert entries(client, "order=newest") == entries(client, "order=oldest")[::-1]


def test_a_cursor_of_the_audit_log_is_an_entry_in_either_order_and_with_any_filter(client):
    for slug in ("one", "two", "three"):
        client.post("/v1/maps", json={"map": slug}, headers=ADMIN)
    first = client.get("/v1/audit?limit=1&order=newest", headers=ADMIN).json()
    assert ([entry["entry"] for entry in first["items"]], first["next_after"]) == ([3], "3")
    client.delete("/v1/maps/one", headers=ADMIN)
    after = f"after={first['next_after']}"
    assert [entry["entry"] for entry in entries(client, f"{after}&order=newest")] == [2, 1]
    assert [entry["entry"] for entry in entries(client, after)] == [4]
    assert entries(client, f"{after}&order=newest&action=delete_map") == []
    assert entries(client, "after=") == entries(client, "after=0") == entries(client)


def test_an_unknown_action_or_order_is_rejected_with_those_there_are(client):
    for query, listed in (("action=make_map", Action), ("order=newset", Order)):
        refused = client.get(f"/v1/audit?action=build&{query}", headers=ADMIN)
        assert problem_of(refused) == (422, "invalid-request")
        [error] = refused.json()["errors"]
        assert query.partition("=")[2] in error["what"]
        assert all(f"'{name}'" in error["what"] for name in listed)


def test_the_actions_are_those_of_the_routes_and_of_the_code_that_names_one(client):
    changing = {
        route.name
        for route in client.app.routes
        if getattr(route, "methods", None) and not route.methods <= {"GET", "HEAD", "OPTIONS"}
        if needed_by(route) != (Scope.LOCALIZE,)
    }
    code = "\n".join(
        path.read_text() for folder in ("app", "storage") for path in Path(folder).rglob("*.py")
    )
    named = re.findall(r'(?:Act\(\s*\w+_ID|\b_act\(|_logged\(\w+),?\s*"(\w+)"', code)
    assert {"expire_capture", "drop_returns", "repair_files", "restore_deleted"} < set(named)
    assert set(Action) - RETIRED == changing | set(named)


def test_the_command_prints_the_last_valid_entry(client, tmp_path):
    for slug in ("one", "two", "three"):
        client.post("/v1/maps", json={"map": slug}, headers=ADMIN)
    verify = ["audit", "verify", "--data", str(tmp_path / "data")]
    run = CliRunner().invoke
    good = run(cli, verify)
    assert good.exit_code == 0
    assert good.output == f"3:{entries(client)[-1]['hash']}\n"
    known = f"2:{entries(client)[1]['hash']}"
    assert run(cli, [*verify, "--known", known]).exit_code == 0
    assert run(cli, [*verify, "--known", f"2:{'0' * 64}"]).exit_code == 1
    with closing(sqlite3.connect(tmp_path / "data/catalog.sqlite3")) as connection, connection:
        connection.execute("DELETE FROM audit WHERE seq = 2")
    connection.close()
    broken = run(cli, verify)
    assert broken.exit_code == 1
    assert "entry 2 is gone" in broken.stderr


def test_the_command_makes_no_store_where_none_is(tmp_path):
    nowhere = tmp_path / "nowhere"
    failed = CliRunner().invoke(cli, ["audit", "verify", "--data", str(nowhere)])
    assert "no catalog" in str(failed.exception)
    assert not nowhere.exists()
    wrong = CliRunner().invoke(cli, ["audit", "verify", "--known", "latest"])
    assert wrong.exit_code == 1


def test_a_refused_change_that_cannot_be_logged_is_one_line_in_the_log(client, tmp_path, caplog):
    writer = holder(client, "maps:write")
    (tmp_path / "data").rename(tmp_path / "before")
    (tmp_path / "data").mkdir()
    for headers in (ADMIN, writer):
        refused = client.post("/v1/maps", json={"map": "yard"}, headers=headers)
        assert problem_of(refused) == (503, "storage-unavailable")
    (tmp_path / "data").rmdir()
    (tmp_path / "before").rename(tmp_path / "data")
    assert "of /v1/maps by key" in caplog.text
    assert "cannot be logged" in caplog.text
    assert not [record.getMessage() for record in caplog.records if record.exc_info]
