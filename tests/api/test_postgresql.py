"""The service on a PostgreSQL catalog, from the first scan to an answer."""

import time

from storage.catalog import Catalog
from tests.support.postgresql import Cluster
from tests.support.process import until
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import problem_of, running, upload, wait_for


def test_a_map_is_built_and_answers_and_is_there_after_a_restart(
    postgresql: Cluster, tmp_path
) -> None:
    url = postgresql.new_database()
    with running(tmp_path / "data", catalog_url=url) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording(scans=12))
        assert upload_again(client).status_code == 200
        job = client.post("/v1/maps/campus/builds", json={"segments": 2}).json()["job"]
        done = wait_for(client, job)
        assert done["state"] == "done", done
        assert localize(client, 9)["best"]["scan_index"] == 9
    assert not (tmp_path / "data" / "catalog.sqlite3").exists()
    with running(tmp_path / "data", catalog_url=url) as client:
        answer = localize(client, 3)
        assert (answer["best"]["scan_index"], answer["revision"]) == (3, done["revision"])
        for path in ("maps/%00", "maps/campus/drives/%00", "jobs/%00"):
            assert problem_of(client.get(f"/v1/{path}"))[0] == 404
        assert client.delete("/v1/maps/campus").status_code == 204
        assert client.get("/v1/jobs").json()["items"] == []


def test_an_unavailable_catalog_is_reported_until_it_is_back(
    postgresql: Cluster, tmp_path, caplog
) -> None:
    url = postgresql.new_database()
    name = url.partition("?")[0].rpartition("/")[2]
    with running(tmp_path / "data", catalog_url=url) as client:
        client.post("/v1/maps", json={"map": "campus"})
        postgresql.run(f"ALTER DATABASE {name} ALLOW_CONNECTIONS false", database="postgres")
        end_connections(postgresql, name)
        # The driver's own text names the host, the port, the user and the database.
        inside = f'database "{name}"'
        refused = client.get("/v1/maps/campus")
        assert problem_of(refused) == (503, "storage-unavailable")
        assert "the catalog's database fails or cannot be reached" in refused.json()["detail"]
        assert inside not in refused.text
        assert inside in caplog.text
        caplog.clear()
        not_ready = client.get("/readyz")
        assert not_ready.status_code == 503
        assert "the catalog cannot be read" in not_ready.json()["missing"][0]
        assert name not in not_ready.text
        assert inside in caplog.text
        postgresql.run(f"ALTER DATABASE {name} ALLOW_CONNECTIONS true", database="postgres")
        assert client.get("/v1/maps/campus").status_code == 200
        assert client.get("/readyz").status_code == 200


def test_a_read_only_catalog_is_reported(postgresql: Cluster, tmp_path) -> None:
    url = postgresql.new_database()
    name = url.partition("?")[0].rpartition("/")[2]
    with running(tmp_path / "data", catalog_url=url) as client:
        client.post("/v1/maps", json={"map": "campus"})
        read_only = f"ALTER DATABASE {name} SET default_transaction_read_only = on"
        postgresql.run(read_only, database="postgres")
        end_connections(postgresql, name)
        assert client.get("/v1/maps").status_code == 200  # what reads first may not write after it
        made = client.post("/v1/maps", json={"map": "new"})
        assert problem_of(made) == (503, "storage-read-only")
        assert [item["map"] for item in client.get("/v1/maps").json()["items"]] == ["campus"]


def end_connections(postgresql: Cluster, name: str) -> None:
    postgresql.run(
        f"SELECT pg_terminate_backend(pid, 10000) FROM pg_stat_activity WHERE datname = '{name}'",
        database="postgres",
    )


def localize(client, index):
    body = kitti(recording(scans=12).scans[index])
    answer = client.post("/v1/maps/campus/localizations/scan", content=body, headers=KITTI)
    assert answer.status_code == 200, answer.text
    return answer.json()


def upload_again(client):
    body = kitti(recording(scans=12).scans[0])
    return client.put("/v1/maps/campus/drives/monday/scans/0", content=body, headers=KITTI)


def test_a_key_that_another_process_revokes_is_refused(postgresql: Cluster, tmp_path) -> None:
    url, admin = postgresql.new_database(), "an-administrators-key"
    with running(tmp_path / "data", catalog_url=url, admin_key=admin) as client:
        client.headers["Authorization"] = f"Bearer {admin}"
        client.post("/v1/maps", json={"map": "campus"})
        made = client.post("/v1/keys", json={"name": "vehicle", "scopes": ["maps:read"]}).json()
        headers = {"Authorization": f"Bearer {made['secret']}"}
        ends_s = time.monotonic() + 2.0  # meanwhile the service begins to listen for changes
        while time.monotonic() < ends_s:
            assert client.get("/v1/maps/campus", headers=headers).status_code == 200
        other = Catalog(url)
        other.keys.revoke(made["key"])
        other.close()
        until(
            lambda: client.get("/v1/maps/campus", headers=headers).status_code == 401,
            "the key is still taken",
        )
