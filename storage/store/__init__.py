"""The store: maps, drives, revisions, jobs and keys of one data directory."""

from storage.store.drives import Drives
from storage.store.maps import Maps
from storage.store.put_scans import PutResult
from storage.store.revisions import Revisions
from storage.store.store import Store
from storage.store.stored_drive import StoredDrive

__all__ = ["Drives", "Maps", "PutResult", "Revisions", "Store", "StoredDrive"]
