"""Tests lie where a reader expects them, and none imports another."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
UNIT = TESTS / "unit"
NO_MIRROR = {UNIT / "core" / "test_paper_figures.py"}
"""Modules of unit tests of more than one module: the paper's figures take all of the core."""


def imported(path: Path) -> Iterator[str]:
    """Yield the dotted names of what a module imports, modules or not."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize(
    "path", sorted(TESTS.rglob("*.py")), ids=lambda path: str(path.relative_to(TESTS))
)
def test_no_module_imports_a_test_module_or_a_conftest(path: Path) -> None:
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == "tests":
            assert not any(part == "conftest" or part.startswith("test_") for part in parts), name


@pytest.mark.parametrize(
    "path", sorted(UNIT.rglob("test_*.py")), ids=lambda path: str(path.relative_to(UNIT))
)
def test_a_module_of_unit_tests_lies_as_the_module_that_it_tests(path: Path) -> None:
    """`tests/unit/<folder>/test_<module>.py`, or `test_<module>_<aspect>.py` beside it."""
    if path in NO_MIRROR:
        return
    relative = path.relative_to(UNIT)
    folder = TESTS.parent / relative.parent
    assert folder.is_dir(), f"{relative.parent} is no package"
    modules = {module.stem for module in folder.iterdir() if module.suffix in {".py", ""}}
    words = path.stem.removeprefix("test_").split("_")
    names = {"_".join(words[:end]) for end in range(1, len(words) + 1)}
    assert names & (modules | {folder.name}), f"{relative} is named for no module"
