"""Statements that are compiled once for all the catalogs that tests open."""

from functools import partial

import pytest
from sqlalchemy import create_engine
from sqlalchemy.engine.default import DefaultDialect

__all__ = ["share_compiled"]


def share_compiled(patch: pytest.MonkeyPatch) -> None:
    """Let catalogs know the statements which others compiled.

    Each of hundreds would compile the same ones. The cache asks for which dialect a statement was
    compiled: here one of a kind is as good as another, as all connect alike.
    """
    patch.setattr(DefaultDialect, "__eq__", lambda one, other: type(one) is type(other))
    patch.setattr(DefaultDialect, "__hash__", lambda one: hash(type(one)))
    shared = partial(create_engine, execution_options={"compiled_cache": {}})
    patch.setattr("storage.catalog.database.create_engine", shared)
