"""Where SQLite finds a catalog, also in a folder that cannot be written, such as a snapshot."""

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import parse_qsl

from sqlalchemy import URL


def uri_of(catalog: Path) -> str:
    """Return the URI of a catalog's file, for reading it as it is now.

    SQLite makes files beside a database in WAL mode even to read it, and reads it where it cannot
    make them only if they are there, as in the snapshot of a running service; or if it is promised
    that nobody writes. That is so without `-wal`, which is there as long as anybody has it open.
    """
    uri = catalog.absolute().as_uri()
    if os.access(catalog.parent, os.W_OK):
        return f"{uri}?mode=rw"
    is_open = catalog.with_name(f"{catalog.name}-wal").exists()
    return f"{uri}?mode=ro" if is_open else f"{uri}?mode=ro&immutable=1"


def url_of(catalog: Path) -> str:
    """Return the SQLAlchemy URL of a catalog's file, for writing it too where that is possible."""
    if os.access(catalog.parent, os.W_OK):
        return url_of_file(catalog)
    uri, _, query = uri_of(catalog).partition("?")
    return _url(uri, {**dict(parse_qsl(query)), "uri": "true"})


def url_of_file(path: Path) -> str:
    """Return the SQLAlchemy URL of a database's file, for reading and writing it.

    Examples:
        >>> url_of_file(Path("/data/100% here?/catalog.sqlite3"))
        'sqlite:////data/100%25 here%3F/catalog.sqlite3'
    """
    return _url(str(path), {})


def _url(database: str, query: Mapping[str, str]) -> str:
    return URL.create("sqlite", database=database, query=query).render_as_string()
