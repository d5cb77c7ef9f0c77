"""The catalog: what is stored, where, and what became of it. HDF5 holds arrays, this holds facts.

Every public method is one transaction and answers with frozen records.
"""

from storage.catalog.acts import Act, on_behalf
from storage.catalog.audit import AuditCheck, AuditRecord, AuditState
from storage.catalog.catalog import Catalog
from storage.catalog.records import (
    DriveRecord,
    IndexRange,
    JobRecord,
    JobState,
    KeyRecord,
    MapRecord,
    Page,
    PosesPut,
    RequestKey,
    RevisionFacts,
    RevisionRecord,
    ScanRecord,
)
from storage.catalog.scan_poses import ScanPoses
from storage.catalog.tokens import TokenRecord

__all__ = [
    "Act",
    "AuditCheck",
    "AuditRecord",
    "AuditState",
    "Catalog",
    "DriveRecord",
    "IndexRange",
    "JobRecord",
    "JobState",
    "KeyRecord",
    "MapRecord",
    "Page",
    "PosesPut",
    "RequestKey",
    "RevisionFacts",
    "RevisionRecord",
    "ScanPoses",
    "ScanRecord",
    "TokenRecord",
    "on_behalf",
]
