"""The catalog: what is stored, where, and its state. HDF5 files hold arrays, the catalog facts.

Every public method is one transaction and returns records that are detached from it.
"""

from storage.catalog.acts import Act, on_behalf
from storage.catalog.audit import AuditCheck, AuditState
from storage.catalog.catalog import Catalog
from storage.catalog.kept import NotKept
from storage.catalog.live_maps import LiveMap
from storage.catalog.models import (
    AuditRecord,
    BasisRecord,
    JobRecord,
    JobState,
    KeyRecord,
    RevisionRecord,
    TokenRecord,
)
from storage.catalog.records import (
    DriveRecord,
    IndexRange,
    MapRecord,
    Page,
    PosesPut,
    RequestKey,
    RevisionFacts,
    ScanRecord,
)
from storage.catalog.saved_tracks import SavedTrack, SavedTracks
from storage.catalog.scan_poses import ScanPoses

__all__ = [
    "Act",
    "AuditCheck",
    "AuditRecord",
    "AuditState",
    "BasisRecord",
    "Catalog",
    "DriveRecord",
    "IndexRange",
    "JobRecord",
    "JobState",
    "KeyRecord",
    "LiveMap",
    "MapRecord",
    "NotKept",
    "Page",
    "PosesPut",
    "RequestKey",
    "RevisionFacts",
    "RevisionRecord",
    "SavedTrack",
    "SavedTracks",
    "ScanPoses",
    "ScanRecord",
    "TokenRecord",
    "on_behalf",
]
