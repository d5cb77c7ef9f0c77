"""Recorded drives: found, counted, and missed aloud when they were promised."""

import pytest

_ran: set[str] = set()


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
