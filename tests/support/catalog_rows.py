"""Rows for catalogs, and the rows of a store."""

import math

from storage.catalog import RevisionFacts, ScanRecord

FACTS = RevisionFacts(encoding="harmonic", scans=10, segments=2, parameters={"rank": [5, 5]})
A, B, C = "a" * 64, "b" * 64, "aaaaaaaaaaaa" + "c" * 52


def scan_record(index, chunk="one.h5", row=0, pose=None, timestamp_s=math.nan):
    return ScanRecord(index, chunk, row, A, 100, 3, timestamp_s, pose)


def stored_scans(store, map_slug, drive_slug):
    """Return the records of all scans of a drive, in the order of their indices."""
    return store.catalog.scans.of_drive(store.drives.get(map_slug, drive_slug).id)


def add_scans(catalog, map_slug, drive_slug, indices, chunk="one.h5"):
    target = catalog.scans.target(map_slug, drive_slug, indices)
    catalog.scans.add(target, [scan_record(index, chunk, row) for row, index in enumerate(indices)])
    return target
