"""Purges of a catalog alone, without the files of a store."""

from storage.catalog import Catalog, RecycledRecord


def finish_purges(catalog: Catalog) -> None:
    """Remove all rows of what is purged, as a store does."""
    for purge in catalog.purges.begun():
        while catalog.purges.remove_some(purge):
            pass
        catalog.purges.end(purge)


def purge_map(
    catalog: Catalog, slug: str, *, if_versions: tuple[int, ...] | None = None
) -> RecycledRecord:
    """Remove a map and all that belongs to it for good."""
    entry = catalog.recycle_bin.put_map(slug, if_versions=if_versions, purging=True)
    finish_purges(catalog)
    return entry


def purge_drive(catalog: Catalog, map_slug: str, slug: str) -> RecycledRecord:
    """Remove a drive and the facts about its scans for good."""
    entry = catalog.recycle_bin.put_drive(map_slug, slug, purging=True)
    finish_purges(catalog)
    return entry


def purge_entry(catalog: Catalog, entry_id: str) -> RecycledRecord:
    """Remove an entry of the recycle bin for good."""
    entry = catalog.recycle_bin.begin_purge(entry_id)
    finish_purges(catalog)
    return entry
