"""SQL that the catalogs of one process share.

Each engine of SQLAlchemy compiles every statement once, for its own dialect; that is half of the
time of a test that starts a service for a few requests.
"""

import functools
from collections.abc import Callable
from typing import Any

from sqlalchemy import Dialect, Engine, create_engine

from storage.catalog import database

Compiled = dict[Any, Any]


@functools.cache
def _of_sqlite() -> tuple[Dialect, Compiled]:
    engine = create_engine("sqlite://")
    with engine.connect():  # the first connection tells a dialect what its database can do
        pass
    engine.dispose()
    return engine.dialect, {}


def share_compiled_statements() -> None:
    """Compile each statement once a process for all catalogs that it opens from now on.

    All of PostgreSQL are in one cluster, and share what the first one that is connected learns.
    """
    create: Callable[..., Engine] = create_engine
    of_postgresql: list[tuple[Dialect, Compiled]] = []

    def sharing(url: str, **options: Any) -> Engine:
        engine = create(url, **options)
        if engine.dialect.name == "sqlite":
            engine.dialect, compiled = _of_sqlite()
        elif not of_postgresql or of_postgresql[0][0].server_version_info is None:
            compiled = {}
            of_postgresql[:] = [(engine.dialect, compiled)]
        else:
            [(engine.dialect, compiled)] = of_postgresql
        engine.update_execution_options(compiled_cache=compiled)
        return engine

    database.create_engine = sharing  # type: ignore[attr-defined, assignment]
