"""The store of a data directory, for commands that need its catalog; its service may run."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from app.process import private_files
from app.settings import Settings
from storage.errors import StorageUnavailable
from storage.store import Store
from storage.store.layout import Layout


@contextmanager
def opened_store(settings: Settings) -> Iterator[Store]:
    """Open the store for a block.

    Raises:
        StorageUnavailable: If the data directory has no catalog: none is made.
    """
    require_catalog(settings.data_dir, settings.catalog_url)
    private_files()
    with Store(settings.data_dir, settings.catalog_url) as store:
        yield store


def require_catalog(data_dir: Path, catalog_url: str | None) -> None:
    """Raise `StorageUnavailable` if a folder is no data directory, or its catalog is elsewhere.

    Raises:
        OSError: If this user may not look into it.
    """
    layout = Layout(data_dir.absolute())
    expected = layout.catalog if catalog_url is None else layout.store_id
    with suppress(FileNotFoundError, NotADirectoryError):
        expected.stat()  # from Python 3.14 on `exists` passes over all errors
        return
    if layout.store_id.exists():
        raise StorageUnavailable(
            f"{data_dir} has no {expected.name}: if its catalog is on PostgreSQL, set"
            " TENSORMAP_CATALOG_URL as for its service; if it is lost, restore a backup"
        )
    raise StorageUnavailable(f"{data_dir} is no data directory: it has no {expected.name}")
