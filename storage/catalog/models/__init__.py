"""The catalog's tables; every change needs a migration.

A class named `...Record` is also what the catalog returns: its rows are detached from the session.
"""

from sqlalchemy.orm import configure_mappers

from storage.catalog.models.access import AuditHead, AuditRecord, KeyRecord, TokenRecord
from storage.catalog.models.base import OPEN_STATES, Base, JobState, StoreId
from storage.catalog.models.jobs import BUILD, CAPTURE, Capture, CapturePart, JobRecord
from storage.catalog.models.maps import (
    PURGED,
    BasisRecord,
    Drive,
    ExpectedPose,
    LiveRevision,
    Map,
    PurgedMap,
    Recycled,
    RevisionBasis,
    RevisionRecord,
    Scan,
)

__all__ = [
    "BUILD",
    "CAPTURE",
    "OPEN_STATES",
    "PURGED",
    "AuditHead",
    "AuditRecord",
    "Base",
    "BasisRecord",
    "Capture",
    "CapturePart",
    "Drive",
    "ExpectedPose",
    "JobRecord",
    "JobState",
    "KeyRecord",
    "LiveRevision",
    "Map",
    "PurgedMap",
    "Recycled",
    "RevisionBasis",
    "RevisionRecord",
    "Scan",
    "StoreId",
    "TokenRecord",
]

configure_mappers()  # now and not at the first query: a process forked later has it
