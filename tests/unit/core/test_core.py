"""What `import core` gives: every name, loaded when it is used."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import core

SOURCE = ast.parse(Path(core.__file__).read_text())


def test_the_public_names_are_sorted_and_each_is_that_of_its_module():
    assert core.__all__ == sorted(set(core.__all__))
    for name in core.__all__:
        given = getattr(core, name)
        assert given is getattr(import_module(given.__module__), name)


def test_what_a_type_checker_reads_is_what_is_loaded():
    typed = {
        alias.name: node.module
        for node in ast.walk(SOURCE)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("core.")
        for alias in node.names
    }
    assert typed == core._MODULE_OF
    assert sorted(typed) == core.__all__


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'core' has no attribute 'nothing'"):
        core.nothing  # noqa: B018
    assert set(core.__all__) <= set(dir(core))


def test_importing_core_or_its_errors_loads_no_numpy():
    program = "import core, core.errors, sys; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
