"""A service with a built map, made once over HTTP and copied for each test."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.access import ADMIN_KEY
from tests.support.city import build_city
from tests.support.locks import one_at_a_time
from tests.support.recording import recording, upload_scan
from tests.support.service import copy_of, running, upload, wait_for
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
            answer.write_text(json.dumps(build(data_dir)))
    before = written(data_dir)
    yield Built(data_dir, *json.loads(answer.read_text()))
    assert written(data_dir) == before, "a service wrote into files that were there"


def written(data_dir):
    """Return when each file that copies share was last written."""
    files = list(data_dir.rglob("*.h5"))
    assert len(files) == 6, files
    return {file: file.stat().st_mtime_ns for file in files}


def build(data_dir):
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording())
        jobs = [
            client.post("/v1/maps/campus/builds", json=body).json()["job"]
            for body in (
                {"segments": 3, **PAPER},
                {"segments": 2, "reducer": "nearest", **PAPER},
            )
        ]
        live, other = (wait_for(client, job)["revision"] for job in jobs)
    return live, other, jobs[0]


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
