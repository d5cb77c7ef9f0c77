"""What the processes that run tests share, and the one that shares tests out among them."""

import gc
import os

import pytest
from xdist.remote import Producer

from tests.support.scheduling import ByModule

_ran: set[str] = set()


def pytest_xdist_auto_num_workers() -> int:
    """Half as many workers again as there are cores: a third of the time tests wait."""
    return max(2, (os.cpu_count() or 1) * 3 // 2)


def pytest_configure(config: pytest.Config) -> None:
    """Take what tests need, which the process that only shares them out does without.

    It would import half of the libraries that there are before any worker starts.
    """
    shares_out = config.getoption("dist") != "no" and not config.option.collectonly
    if hasattr(config, "workerinput") or not shares_out:
        config.pluginmanager.import_plugin("tests.support.fixtures")


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> ByModule:
    """Share tests out by module, in the order of their names."""
    config.option.loadscopereorder = False  # documents, which take longest, would come last
    return ByModule(config, log)


def pytest_collection_finish() -> None:
    """What was imported stays: no garbage collection looks at it again."""
    gc.freeze()


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
