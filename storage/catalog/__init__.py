"""The catalog: what is stored, where, and its state. HDF5 files hold arrays, the catalog facts.

Every public method is one transaction and returns records that are detached from it.
"""

from storage.catalog.acts import EVERYONE_ID, OPERATOR_ID, SERVICE_ID, Act, on_behalf
from storage.catalog.audit import AuditCheck, AuditState
from storage.catalog.catalog import Catalog
from storage.catalog.kept import NotKept
from storage.catalog.map_summaries import MapSummary
from storage.catalog.maps import Keep
from storage.catalog.models import (
    BUILD,
    CAPTURE,
    AuditRecord,
    BasisRecord,
    JobRecord,
    JobState,
    KeyRecord,
    RevisionRecord,
    TokenRecord,
)
from storage.catalog.purges import Purge
from storage.catalog.records import (
    CaptureRecord,
    CaptureState,
    CaptureSummary,
    CountedDrive,
    DriveRecord,
    FilledDrive,
    IdempotencyKey,
    MapRecord,
    NewCapture,
    Page,
    PosesPut,
    RevisionFacts,
    ScanRecord,
)
from storage.catalog.recycle_bin import RecycledRecord
from storage.catalog.saved_tracks import SavedTrack, SavedTracks
from storage.catalog.scan_poses import ScanPoses

__all__ = [
    "BUILD",
    "CAPTURE",
    "EVERYONE_ID",
    "OPERATOR_ID",
    "SERVICE_ID",
    "Act",
    "AuditCheck",
    "AuditRecord",
    "AuditState",
    "BasisRecord",
    "CaptureRecord",
    "CaptureState",
    "CaptureSummary",
    "Catalog",
    "CountedDrive",
    "DriveRecord",
    "FilledDrive",
    "IdempotencyKey",
    "JobRecord",
    "JobState",
    "Keep",
    "KeyRecord",
    "MapRecord",
    "MapSummary",
    "NewCapture",
    "NotKept",
    "Page",
    "PosesPut",
    "Purge",
    "RecycledRecord",
    "RevisionFacts",
    "RevisionRecord",
    "SavedTrack",
    "SavedTracks",
    "ScanPoses",
    "ScanRecord",
    "TokenRecord",
    "on_behalf",
]
