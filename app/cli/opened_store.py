"""The store of a data directory, for commands that need its catalog; its service may run."""

from collections.abc import Iterator
from contextlib import contextmanager

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
    layout = Layout(settings.data_dir.absolute())
    if settings.catalog_url is None and not layout.catalog.exists():
        raise StorageUnavailable(f"there is no catalog in {settings.data_dir}")
    private_files()
    with Store(settings.data_dir, settings.catalog_url) as store:
        yield store
