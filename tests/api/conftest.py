"""Services with built maps, made once over HTTP and copied for each test."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.access import ADMIN_KEY
from tests.support.bags import cloud, record_bag
from tests.support.campus import MAP, basis_of, build
from tests.support.capture_uploads import SCANS
from tests.support.city import build_city
from tests.support.locks import one_at_a_time
from tests.support.recording import NPY, Recording, far_away, npy, recording, upload_scan
from tests.support.service import copy_of, running, upload
from tests.support.tracks import new_track
from tests.support.workers import never_end

PAPER = {"encoding": "paper"}


@dataclass(frozen=True)
class Built:
    """A stopped service's data: map `campus`, drive `monday`, two revisions, the first live."""

    data_dir: Path
    live: str
    other: str
    job: str


@pytest.fixture(scope="session")
def built(shared):
    data_dir, answer = shared / "built" / "data", shared / "built.json"
    with one_at_a_time(shared / "built.lock"):
        if not answer.exists():
            answer.write_text(json.dumps(build_two_revisions(data_dir)))
    before = written(data_dir)
    yield Built(data_dir, *json.loads(answer.read_text()))
    assert written(data_dir) == before, "a service wrote into files that were there"


def written(data_dir):
    """Return when each file that copies share was last written."""
    files = list(data_dir.rglob("*.h5"))
    assert len(files) == 6, files
    return {file: file.stat().st_mtime_ns for file in files}


def build_two_revisions(data_dir):
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording())
        live = build(client, segments=3, **PAPER)
        other = build(client, segments=2, reducer="nearest", **PAPER)
    return live["revision"], other["revision"], live["job"]


@pytest.fixture(scope="session")
def campus_of(shared: Path) -> Callable[..., Path]:
    """Return the data of a stopped service: map `campus` of drive `monday`, built as is said."""

    def made(**parameters: object) -> Path:
        name = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()[:16]
        data_dir, done = shared / f"campus-{name}" / "data", shared / f"campus-{name}.done"
        with one_at_a_time(shared / f"campus-{name}.lock"):
            if not done.exists():
                with running(data_dir) as client:
                    client.post("/v1/maps", json={"map": "campus"})
                    upload(client, "monday", recording())
                    build(client, **parameters)
                done.touch()
        return data_dir

    return made


@pytest.fixture(scope="session")
def closed_drive(shared):
    """The data of a stopped service: a map of closed drive `monday`, and drive `tuesday` beside it.

    The last scan of `monday` is of no use to a map.
    """
    data_dir, done = shared / "closed" / "data", shared / "closed.done"
    with one_at_a_time(shared / "closed.lock"):
        if not done.exists():
            with running(data_dir) as client:
                client.post("/v1/maps", json={"map": "campus"})
                upload(client, "monday", Recording(recording().scans[:16]))
                upload(client, "tuesday", Recording(recording().scans[16:24]))
                monday = f"{MAP}/drives/monday"
                client.put(f"{monday}/scans/16", content=npy(far_away()), headers=NPY)
                client.patch(monday, json={"closed": True})
                plain = {"segment_length": 8, "lateral_renderings_m": [0], "views": "full"}
                build(client, drives=["monday"], **plain)
            done.touch()
    return data_dir


@pytest.fixture
def mapped(tmp_path, closed_drive):
    """A service of such data, for a test that changes it."""
    with running(copy_of(closed_drive, tmp_path / "data")) as client:
        yield client


@pytest.fixture(scope="session")
def city(shared):
    """The data of a stopped service: the districts of `tests.support.city`, maps of two bases."""
    data_dir, done = shared / "city" / "data", shared / "city.done"
    with one_at_a_time(shared / "city.lock"):
        if not done.exists():
            build_city(data_dir)
            done.touch()
    return data_dir


@pytest.fixture(scope="session")
def client(tmp_path_factory, built):
    """The built map, for tests that change nothing."""
    with running(copy_of(built.data_dir, tmp_path_factory.mktemp("client") / "data")) as client:
        yield client


@pytest.fixture(scope="module")
def basis(client):
    """The basis of the live revision of a module's service."""
    return basis_of(client)


@pytest.fixture
def track(client):
    """A track of a module's service, until the test ends."""
    created = new_track(client)
    yield created
    client.delete(created)


@pytest.fixture
def own(tmp_path, built):
    """A copy of the built map, for a test that changes it."""
    with running(copy_of(built.data_dir, tmp_path / "data")) as client:
        yield client


@pytest.fixture
def empty(tmp_path):
    """A service that has the map `campus` and nothing in it."""
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        yield client


@pytest.fixture(scope="module")
def of_module(tmp_path_factory):
    """A service of a module's tests."""
    with running(tmp_path_factory.mktemp("module") / "data") as client:
        yield client


@pytest.fixture
def emptied(of_module):
    """The map `campus` with nothing in it, for tests that change this map and nothing else.

    They share a service, whose start and end take 40 ms.
    """
    made = of_module.post("/v1/maps", json={"map": "campus"})
    assert made.status_code == 201, made.text
    yield of_module
    assert of_module.delete("/v1/maps/campus").status_code in {204, 404}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory, built):
    """A service with keys that has maps `campus`, built, and `dock`, empty."""
    data_dir = copy_of(built.data_dir, tmp_path_factory.mktemp("guarded") / "data")
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "dock"})
    with running(data_dir, admin_key=ADMIN_KEY) as client:
        yield client


@pytest.fixture
def stuck(empty, monkeypatch):
    """A service whose workers never end, with one scan."""
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    upload_scan(empty, "campus", "monday", 0, recording().scans[0])
    return empty


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> bytes:
    """An MCAP of three clouds on one topic; in parts of 64 KiB it has two."""
    folder = record_bag(tmp_path_factory.mktemp("bag") / "bag", map(cloud, SCANS))
    [file] = folder.glob("*.mcap")
    return file.read_bytes()
