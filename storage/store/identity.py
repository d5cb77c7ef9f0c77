"""Whether a folder is a data directory, and whether a catalog belongs to it, by a common id."""

from pathlib import Path

from core.errors import InvalidParameters
from storage.catalog import Catalog
from storage.errors import StorageUnavailable, WrongCatalog
from storage.files.files import make_folder, publish
from storage.names import new_id
from storage.store.layout import Layout

_OF_FILE_SYSTEMS = {"lost+found"}


def require_own_folder(layout: Layout) -> None:
    """Reject a folder with other content, which would become private and be filled with our files.

    An empty or new folder may become a data directory. A data directory has a catalog or, where the
    catalog is on PostgreSQL, a store-id, in the oldest ones only the server's lock. An empty file
    is no catalog: it is what a first start leaves that is killed at once.

    Raises:
        InvalidParameters: If it holds something, and none of these; it is left as it is.
    """
    if not layout.data_dir.exists():
        return
    names = names_in(layout.data_dir)
    if layout.catalog.is_file() and not layout.catalog.stat().st_size:
        names.remove(layout.catalog.name)
    ours = {path.name for path in (layout.catalog, layout.store_id, layout.lock)}
    if names and not names & ours:
        raise InvalidParameters(
            f"{layout.data_dir} is no data directory, it has no {layout.catalog.name} or"
            f" {layout.store_id.name}, and is not empty, it has {min(names)!r}: wanted a data"
            " directory, an empty folder or a new one"
        )


def is_empty(folder: Path) -> bool:
    """Return whether a folder has nothing but what its file system made."""
    return not names_in(folder)


def names_in(folder: Path) -> set[str]:
    """Return the names of what a folder has, without what its file system made."""
    return {path.name for path in folder.iterdir()} - _OF_FILE_SYSTEMS


def prepare_folder(layout: Layout, of_catalog: str | None, *, has_maps: bool) -> None:
    """Make the folder of a new store, or reject a catalog that is not this folder's.

    Args:
        layout: The data directory.
        of_catalog: The id of the store that the catalog belongs to; `None` before its first use.
        has_maps: Whether the folder had maps before the catalog was read: later they may be those
            of another process that made the catalog.

    Raises:
        WrongCatalog: If the ids differ, or the folder is of an old store that lost its catalog.
    """
    if of_catalog is not None or has_maps:
        require_same_store(of_catalog, layout)
    make_folder(layout.data_dir)


def check_identity(catalog: Catalog, layout: Layout) -> None:
    """Reject a catalog that is not this directory's; a new one and a new directory are paired.

    Raises:
        WrongCatalog: If the ids differ, or one is missing and not both sides are new.
    """
    # Read in the reverse of the order in which they are made, file, catalog, map: so no part that
    # another process makes meanwhile seems to be missing.
    in_use = catalog.store_id.in_use() or has_maps(layout)
    of_catalog = catalog.store_id.get()
    if of_catalog is None and not in_use:
        of_catalog = catalog.store_id.ensure(lambda: store_id_in(layout) or _make(layout))
    require_same_store(of_catalog, layout)


def require_same_store(of_catalog: str | None, layout: Layout) -> None:
    """Reject a catalog that is not of this directory's store.

    Args:
        of_catalog: The id of the store that the catalog belongs to, if it has one.
        layout: The data directory.

    Raises:
        WrongCatalog: If the directory's id is another one, or one of them is missing.
    """
    of_folder = store_id_in(layout)
    if of_catalog is None or of_folder != of_catalog:
        raise WrongCatalog(
            f"the catalog belongs to store {of_catalog or '(none)'}, but {layout.data_dir} holds"
            f" store {of_folder or '(no file store-id)'}: name the catalog and the data directory"
            " that belong together, or restore both from one backup"
        )


def require_files(catalog: Catalog, layout: Layout) -> None:
    """Reject a folder of maps that is empty, where the catalog names files in it.

    It may be the mount point of a disk that is not mounted. What would be written into it would be
    hidden when it is, and what it holds would be taken for lost.

    Raises:
        StorageUnavailable: If it is so.
    """
    if is_empty(layout.maps) and catalog.store_id.has_files():
        of_a_map = layout.map(min(catalog.drives.by_map()))  # no start removes it
        raise StorageUnavailable(
            f"{layout.maps} is empty, and the catalog names files in it: mount its disk, or bring"
            f" back its files from a backup; to go on without them, make the folder {of_a_map}"
        )


def store_id_in(layout: Layout) -> str | None:
    """Return the id of the store that a data directory is of, `None` if it has none yet."""
    if not layout.store_id.exists():
        return None
    return layout.store_id.read_text(errors="replace").strip()  # damaged, it is no store's id


def has_maps(layout: Layout) -> bool:
    """Return whether the data directory has the folder of a map."""
    return layout.maps.is_dir() and any(layout.maps.iterdir())


def _make(layout: Layout) -> str:
    make_folder(layout.data_dir)
    made = new_id()
    with publish(layout.store_id) as part:
        part.write_text(f"{made}\n")
    return made
