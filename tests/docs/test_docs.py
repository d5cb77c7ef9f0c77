"""Every command and program of the documents runs, and every table is that of the code."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from tests.docs.blocks import READ_ONLY, Block, Runner, blocks_of
from tests.docs.tables import CLIENT_PROBLEMS, TABLES, client_problems, with_table
from tests.support.commands import ROOT
from tests.support.cpp import COMPILER, EXAMPLES
from tests.support.odometry import CAN_COMPUTE, NO_LIBRARY

DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    EXAMPLES / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
NOT_RUN = {
    "make demo": "the acceptance run itself, with a target and a test of its own",
    "make test": "runs this test",
    "make test-fast": "runs some of the same tests",
    "make coverage": "runs this test",
    "make install": "makes the environment that runs this test",
    "make lint": "a job of its own",
    "make torture": "takes hours; .ci/run runs four minutes of it",
    "make bench": "takes half an hour; .ci/run runs some of it",
    "TENSORMAP_TORTURE_SEED=": "takes minutes; .ci/run runs the same",
    ".venv/bin/python -m tests.docs.tables": "test_a_table_is_that_of_the_code does the same",
    "TENSORMAP_SCHEMATHESIS_EXAMPLES=": "takes minutes; `make test` runs it with few examples",
    "python3 -m http.server": "serves a page until it is stopped; its modules have tests",
    "docker compose up": "needs a container engine",
    "docker compose logs": "needs a container engine",
    "docker compose -f": "needs a container engine",
    "docker compose exec": "needs a container engine",
    "docker inspect": "needs a container engine",
    "sudo ": "changes the machine; its files are checked in tests/e2e/test_deployment.py",
    "export DRIVE=": "needs a recorded data set that is not ours to ship",
}
"""How blocks that stay unexecuted begin, and why."""


def reason_not_to_run(block: Block) -> str | None:
    return next((why for start, why in NOT_RUN.items() if block.text.startswith(start)), None)


def runnable(path: Path) -> list[Block]:
    return [block for block in blocks_of(path) if reason_not_to_run(block) is None]


@pytest.mark.skipif(shutil.which("curl") is None, reason="the documents' examples call curl")
@pytest.mark.parametrize(
    "path",
    [path for path in DOCUMENTS if any(b.language not in READ_ONLY for b in runnable(path))],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_every_block_runs_and_prints_its_documented_output(path: Path, tmp_path: Path) -> None:
    if path.parent == EXAMPLES:
        if COMPILER is None or shutil.which("node") is None:
            pytest.skip("the examples are compiled, and run by Node.js")
        tmp_path = _copy_of_examples(tmp_path)
    if path.name == "odometry.md" and not CAN_COMPUTE:
        pytest.skip(NO_LIBRARY)
    runner = Runner(tmp_path)
    try:
        for block in runnable(path):
            runner.run(block)
    finally:
        runner.close()


def _copy_of_examples(folder: Path) -> Path:
    """Return a copy of the examples, beside the tests as in the repository."""
    (folder / "tests").symlink_to(ROOT / "tests")
    return Path(shutil.copytree(EXAMPLES, folder / "examples"))


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_block_is_of_a_kind_that_is_run_or_only_read(path: Path) -> None:
    kinds = {block.language for block in blocks_of(path)}
    assert kinds <= {"sh", "python"} | READ_ONLY


def test_every_exception_is_still_needed() -> None:
    blocks = [block for path in DOCUMENTS for block in blocks_of(path)]
    for start in NOT_RUN:
        assert any(block.text.startswith(start) for block in blocks), start


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_that_of_the_code(name: str) -> None:
    found, expected = with_table(name)
    assert found == expected, "run `python -m tests.docs.tables`"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_to_a_file_leads_there(path: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text()):
        if not re.match(r"[a-z]+:", target):
            assert (path.parent / target).exists(), f"{path.name} links to {target}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_install_of_the_service_names_the_client_that_no_registry_has(path: Path) -> None:
    for command in re.findall(r"pip install ([^`\n]+)", path.read_text()):
        named = shlex.split(command)
        if any(argument.startswith(".[") for argument in named):
            assert {"clients/python", "./clients/python"} & set(named), command


def test_the_clients_errors_are_the_services() -> None:
    expected = "\n".join([*client_problems(), ""])
    assert CLIENT_PROBLEMS.read_text() == expected, "run `python -m tests.docs.tables`"
