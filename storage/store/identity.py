"""Whether a catalog and a data directory belong together: both keep the same random id."""

from storage.catalog import Catalog
from storage.errors import WrongCatalog
from storage.files.files import publish
from storage.names import new_id
from storage.store.layout import Layout

__all__ = ["check_identity"]


def check_identity(catalog: Catalog, layout: Layout) -> None:
    """Refuse a catalog that is not this directory's; a new one and a new directory are paired.

    Raises:
        WrongCatalog: If the ids differ, or one is missing and not both sides are new.
    """
    # Read in the reverse of the order in which they are made, file, catalog, map: what another
    # process makes meanwhile cannot look like a part that is missing.
    in_use = catalog.store_id.in_use() or any(layout.maps.iterdir())
    of_catalog = catalog.store_id.get()
    if of_catalog is None and not in_use:
        of_catalog = catalog.store_id.ensure(lambda: _of_folder(layout) or _make(layout))
    of_folder = _of_folder(layout)
    if of_catalog is None or of_folder != of_catalog:
        raise WrongCatalog(
            f"the catalog belongs to store {of_catalog or '(none)'}, but {layout.data_dir} holds"
            f" store {of_folder or '(no file store-id)'}: name the catalog and the data directory"
            " that belong together, or restore both from one backup"
        )


def _of_folder(layout: Layout) -> str | None:
    return layout.store_id.read_text().strip() if layout.store_id.exists() else None


def _make(layout: Layout) -> str:
    made = new_id()
    with publish(layout.store_id) as part:
        part.write_text(f"{made}\n")
    return made
