"""Fixtures of all tests, and what a process that runs tests begins with."""

import gc
import importlib
import multiprocessing
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from app.builds.worker import IMPORTED_LATE
from app.process import one_blas_thread
from storage.catalog import database, migrations
from tests.support.commands import Commands, commands
from tests.support.forking import fork_builds
from tests.support.postgresql import Cluster, cluster, reason_to_skip
from tests.support.schema import made_once
from tests.support.statements import share_compiled

multiprocessing.set_forkserver_preload(["app.builds.worker", *IMPORTED_LATE])  # whoever starts it
one_blas_thread()  # as every command and service does for itself
gc.set_threshold(20_000, 20, 20)  # seldom: little of what tests leave behind are cycles

_CORES = os.sched_getaffinity(0)


def pytest_configure(config: pytest.Config) -> None:
    """Keep each of the first workers on a core of its own; the others go where there is room.

    Requests pass from thread to thread: where another core has to wake up for that each time, all
    tests take a twelfth more processor time (on two cores).
    """
    told = getattr(config, "workerinput", None)  # none where one process does everything
    if told is not None:
        worker = int(told["workerid"].removeprefix("gw"))
        if worker < len(_CORES):
            os.sched_setaffinity(0, {sorted(_CORES)[worker]})
    for module in IMPORTED_LATE:
        importlib.import_module(module)
    fork_builds()  # while there is little to fork; it stays where its worker does


@pytest.fixture(scope="session", autouse=True)
def _catalogs_made_quickly() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(database, "upgrade", made_once(migrations.upgrade))
        share_compiled(patch)
        yield


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all workers: what one of them has made there the others need not make."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture
def all_cores() -> Iterator[None]:
    """Let a test use every core: what it starts at once would only take turns on one."""
    kept = os.sched_getaffinity(0)
    os.sched_setaffinity(0, _CORES)
    yield
    os.sched_setaffinity(0, kept)


@pytest.fixture(scope="session")
def tensormap(shared: Path) -> Commands:
    """Runs the command line."""
    tests = os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else os.getpid()
    return commands(shared, tests)


DATABASES = ["sqlite", "postgresql"]
"""What the catalog can stand on."""


@pytest.fixture(scope="session")
def postgresql() -> Iterator[Cluster]:
    """A PostgreSQL of this session's own."""
    reason = reason_to_skip()
    if reason is not None:
        pytest.skip(reason)
    with cluster() as running:
        yield running


@pytest.fixture
def new_postgresql(postgresql: Cluster) -> Iterator[Callable[[], str]]:
    """Makes an empty database on PostgreSQL, and returns its URL."""
    with postgresql.databases() as make:
        yield make


@pytest.fixture
def new_database(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str], str]:
    """Makes an empty database of a kind, and returns its URL."""

    def make(kind: str) -> str:
        if kind == "sqlite":
            return f"sqlite:///{tmp_path / 'catalog.sqlite3'}"
        new_postgresql: Callable[[], str] = request.getfixturevalue("new_postgresql")
        return new_postgresql()

    return make


@pytest.fixture(params=DATABASES)
def database_url(request: pytest.FixtureRequest, new_database: Callable[[str], str]) -> str:
    """The URL of an empty database, of each kind."""
    return new_database(request.param)
