"""Services as processes of their own."""

import functools

import pytest

from tests.support import process


@pytest.fixture(scope="session")
def serving(tensormap):
    """`tests.support.process.serving`, forked."""
    return functools.partial(process.serving, commands=tensormap)
