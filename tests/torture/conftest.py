"""Attacks on the service: only where they are selected by the name of their folder.

`make torture` runs them long, `.ci/run` four minutes of them; see CONTRIBUTING.md.
"""

from pathlib import Path

import pytest

from tests.torture.support import faults
from tests.torture.support.sizes import SEED, TREE

HERE = Path(__file__).parent


def _are_selected(config: pytest.Config) -> bool:
    return any(HERE.name in word for word in config.args)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave all this out unless a word of the command line names it; `make test` does not."""
    return None if _are_selected(config) else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of this folder."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker("torture")


def pytest_report_header() -> str:
    """Report what is attacked, and what repeats this run."""
    return f"torture of {TREE}: TENSORMAP_TORTURE_SEED={SEED} repeats this run"


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Give the figures of what passed, and the seed once more: a run is read from its end."""
    if not _are_selected(config):
        return
    for report in terminalreporter.stats.get("passed", ()):
        for line in report.capstdout.splitlines():
            terminalreporter.write_line(f"{report.nodeid.rpartition('::')[2]}: {line}")
    terminalreporter.write_line(f"TENSORMAP_TORTURE_SEED={SEED} repeats this run")


@pytest.fixture(scope="session")
def faults_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is preloaded so that writes fail."""
    reason = faults.reason_to_skip()
    if reason is not None:
        pytest.skip(reason)
    return faults.built_library(tmp_path_factory.mktemp("faults"))
