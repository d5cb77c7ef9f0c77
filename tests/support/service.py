"""A service in this process, and a client that checks every answer against the OpenAPI document."""

import functools
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from starlette.testclient import TestClient

from app.main import create_app
from app.service import Service
from app.settings import Settings
from core.scans.pose import Pose
from tests.support.new_catalog import put_new_catalog
from tests.support.recording import TAR, Recording, kitti, tar

PROBLEM = "application/problem+json"
ENDED = {"done", "failed", "cancelled"}


# What any answer over HTTP may have, for caches, proxies and browsers.
_OF_ALL_HTTP = {
    *("cache-control", "connection", "content-encoding", "content-length", "content-type", "vary"),
    *("content-security-policy", "cross-origin-resource-policy", "referrer-policy"),
    *("x-accel-buffering", "x-content-type-options"),
    *("access-control-allow-origin", "access-control-expose-headers"),
}


class Client(TestClient):
    """A client on this machine; every answer to it must be one that the API documents."""

    def __init__(self, app: FastAPI, **options: Any) -> None:
        options.setdefault("base_url", "http://127.0.0.1")
        super().__init__(app, client=("127.0.0.1", 5000), raise_server_exceptions=False, **options)
        self.documented = document()

    @property
    def service(self) -> Service:
        """The parts of the service."""
        service: Service = self.app.state.service  # type: ignore[attr-defined]
        return service

    def request(self, method, url, **options):
        response = super().request(method, url, **options)
        has_body = method != "HEAD"
        if response.status_code >= 400 and has_body and not _is_readiness(response):
            require_problem(response)
        self._require_documented(response)
        return response

    def _require_documented(self, response) -> None:
        operation = self._operation(response.request)
        if operation is None or b'"/problems/no-such-route"' in response.content:
            return
        documented = operation["responses"].get(str(response.status_code))
        request = f"{response.request.method} {response.request.url.path}"
        assert documented is not None, (
            f"{request} answered {response.status_code}: {response.text[:300]}"
        )
        kind = response.headers.get("content-type", "").partition(";")[0]
        if response.content:
            assert kind in documented["content"], f"{request} answered {kind}"
        missing = _undescribed(response, documented.get("headers", {}))
        assert not missing, f"{request} answered {response.status_code}: {missing}"
        if kind == PROBLEM:
            name = response.json()["type"].removeprefix("/problems/")
            assert name in documented["content"][PROBLEM]["examples"], f"{request} ended in {name}"

    def _operation(self, request):
        raw = request.url.raw_path.decode().partition("?")[0]
        for template, operations in self.documented["paths"].items():
            if _pattern(template).fullmatch(raw):
                return operations.get(request.method.lower())
        return None


@functools.cache
def _pattern(template: str) -> re.Pattern[str]:
    return re.compile(re.sub(r"\{\w+\}", "[^/]+", template))


@functools.cache
def document() -> dict[str, Any]:
    """Return the OpenAPI document, whatever the settings."""
    return create_app(Settings()).openapi()


def _undescribed(response, described: dict[str, Any]) -> list[str]:
    """Return the fields of a head that are not described, and those that should be there."""
    fields = {name.lower(): field for name, field in described.items()}
    sent = response.headers.keys() - _OF_ALL_HTTP
    wanted = {name for name, field in fields.items() if field["required"]}
    return sorted((sent - fields.keys()) | (wanted - response.headers.keys()))


def _is_readiness(response) -> bool:
    return bool(response.request.url.path == "/readyz")


def require_problem(response) -> None:
    """Require an error to be a problem as RFC 9457 writes it."""
    assert response.headers["content-type"] == PROBLEM, response.text[:300]
    problem = response.json()
    assert problem["status"] == response.status_code
    assert problem["type"].startswith("/problems/")
    assert problem["title"]
    assert problem["detail"]
    assert "Traceback" not in response.text


def problem_of(response) -> tuple[int, str]:
    """Return an error's status and the name of its type."""
    require_problem(response)
    return response.status_code, response.json()["type"].removeprefix("/problems/")


@contextmanager
def running(data_dir: Path, **settings: Any) -> Iterator[Client]:
    """Run a service on a data directory; a new one has an empty catalog already."""
    if not data_dir.exists() and settings.get("catalog_url") is None:
        data_dir.mkdir(parents=True)
        put_new_catalog(data_dir / "catalog.sqlite3")
    with Client(create_app(Settings(data_dir=data_dir, **settings))) as client:
        yield client


def pose_text(pose: Pose) -> str:
    """Return a pose as a query parameter."""
    return ",".join(map(str, pose.as_tuple()))


def copy_of(data_dir: Path, to: Path) -> Path:
    """Copy the data of a service, which may run, and return where they are then.

    A service never writes into a file of scans, images or a revision: the copy's are the same files
    by other names. Who damages one puts another in its place, with `damage`.
    """

    def copied(file: str, copy: str) -> None:
        if file.endswith(".h5"):
            os.link(file, copy)
        else:
            shutil.copy2(file, copy)

    ignored = shutil.ignore_patterns("*.lock")
    return Path(shutil.copytree(data_dir, to, ignore=ignored, copy_function=copied))


def damage(file: Path, content: bytes | bytearray) -> None:
    """Put other content in the place of a file of a service's data."""
    file.unlink()
    file.write_bytes(content)


def upload(client, drive: str, recording: Recording, *, slug: str = "campus") -> None:
    """Put a drive, its scans in one stream, then their poses and times."""
    drives = f"/v1/maps/{slug}/drives/{drive}"
    sent = client.post(
        f"{drives}/scans",
        content=tar((f"{i:06}.bin", kitti(scan)) for i, scan in enumerate(recording.scans)),
        headers=TAR,
        params={"format": "kitti"},
    )
    assert sent.status_code == 200, sent.text
    assert sent.json()["scans_stored"] == len(recording), sent.text
    poses = [
        {"scan": i, "timestamp_s": scan.timestamp_s, "pose": recording.pose(i).as_tuple()}
        for i, scan in enumerate(recording.scans)
    ]
    placed = client.put(f"{drives}/poses", json={"poses": poses})
    assert placed.status_code == 200, placed.text


def wait_for(client, job: str, states: set[str] | frozenset[str] = frozenset(ENDED)) -> Any:
    """Poll a job until it is in one of these states."""
    deadline = time.monotonic() + 300  # far more than it takes, on a busy machine too
    while time.monotonic() < deadline:
        answer = client.get(f"/v1/jobs/{job}").json()
        if answer["state"] in states:
            return answer
        assert answer["state"] not in ENDED, answer
        time.sleep(0.1)  # a request takes a tenth of that, from a build on the same cores
    raise AssertionError(f"job {job} is still {answer['state']}")


def whole_store(client: Client) -> tuple[Any, ...]:
    """Return everything that a store holds: its lists, and the names of its files."""
    maps = client.get("/v1/maps").json()["items"]
    drives = [client.get(f"/v1/maps/{m['map']}/drives").json() for m in maps]
    revisions = [client.get(f"/v1/maps/{m['map']}/revisions").json() for m in maps]
    folder = client.service.settings.data_dir
    files = sorted(
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        # The collector writes the clock's file in a thread of its own.
        if not path.name.startswith(("catalog.sqlite3", "clock.json", ".clock.json."))
    )
    return maps, drives, revisions, files
