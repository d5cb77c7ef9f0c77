"""Fixtures of all tests, and the switches of a run."""

import gc
import os
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import hypothesis
import pytest

from app.jobs import runner
from app.process import collect_seldom, one_blas_thread
from storage.files.forking import forkserver
from tests.support.postgresql import Cluster, cluster, reason_to_skip
from tests.support.statements import share_compiled_statements

DATABASES = ["sqlite", "postgresql"]
"""The databases that the catalog supports."""

one_blas_thread()  # as every command and service does for itself
share_compiled_statements()
# A process forks all builds of a worker. Where a check of a file starts it, before there is a
# service, it would have imported nothing, and each build would import SciPy: a second and a half.
runner.PRELOADED = "tests.support.preloaded"
forkserver().set_forkserver_preload([runner.PRELOADED])
# The machine is shared, and no example is timed.
hypothesis.settings.register_profile("shared-machine", deadline=None)
hypothesis.settings.load_profile("shared-machine")

# Services under test are on this machine, which a proxy of the environment does not reach.
_NO_PROXY = filter(None, (os.environ.get("no_proxy"), "127.0.0.1,localhost,::1"))
os.environ["no_proxy"] = os.environ["NO_PROXY"] = ",".join(_NO_PROXY)

_DOCUMENTS = Path(__file__).parent / "docs"
_LONGEST_ID = 200
_ran: set[str] = set()


def pytest_xdist_auto_num_workers() -> int:
    """Half as many workers again as there are cores: a third of the time tests wait."""
    return max(2, (os.cpu_count() or 1) * 3 // 2)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect no garbage while tests are collected: a sixth of that time, in each worker."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name long parameters by their lengths: whole files in the names of tests are megabytes."""
    if isinstance(val, str | bytes) and len(val) > _LONGEST_ID:
        return f"{argname}-of-{len(val)}"
    return None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the documents, which take ten seconds each.

    Workers take over tests of another one from the end of what it has left. The documents were
    there: at the end of a run one worker ran the last of them while the others had nothing to do.
    """
    items.sort(key=lambda item: not item.path.is_relative_to(_DOCUMENTS))


def pytest_collection_finish() -> None:
    """Leave thousands of tests and all that they imported out of garbage collections."""
    collect_seldom()


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all workers: what one of them has made there the others need not make."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


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


@pytest.fixture
def collect_own() -> Iterator[Callable[[], object]]:
    """Collects what a test itself leaves: a full collection visits a run's objects for 0.5 s."""
    was_enabled = gc.isenabled()
    gc.disable()  # so that the test's own are all young
    try:
        yield lambda: gc.collect(0)
    finally:
        if was_enabled:
            gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--require-real-data",
        action="store_true",
        help="Fail if not one test on recorded drives ran.",
    )


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call" and not report.skipped and "real_data" in report.keywords:
        _ran.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.getoption("--require-real-data") and not _ran:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    if _ran or config.getoption("--require-real-data"):
        terminalreporter.write_line(f"tests on recorded drives: {len(_ran)} ran")
