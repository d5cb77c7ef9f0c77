"""Statements that are compiled once for all the catalogs that tests open."""

from typing import Any

import pytest
from sqlalchemy import Engine, create_engine

__all__ = ["share_compiled"]


def share_compiled(patch: pytest.MonkeyPatch) -> None:
    """Let catalogs know the statements which others compiled.

    Each of hundreds would compile the same ones. The cache asks for which dialect a statement was
    compiled: here one of a kind is as good as another, as all connect alike.
    """
    compiled: dict[Any, Any] = {}

    def create(url: str, **options: Any) -> Engine:
        engine = create_engine(url, execution_options={"compiled_cache": compiled}, **options)
        kind = type(engine.dialect)
        patch.setattr(kind, "__eq__", lambda one, other: type(one) is type(other))
        patch.setattr(kind, "__hash__", lambda one: hash(type(one)))
        return engine

    patch.setattr("storage.catalog.database.create_engine", create)
