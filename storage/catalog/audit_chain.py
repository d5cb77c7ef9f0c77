"""The chain of the audit log: each entry's hash covers the entry and the hash before it."""

import hashlib
import json
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from storage.catalog.acts import Act
from storage.catalog.models import AuditEntry, AuditHead

DONE = "done"
_ROW = 1


def append(session: Session, act: Act, outcome: str) -> None:
    """Add an entry within the caller's transaction; two never get the same place."""
    head = head_of(session, lock=True)
    row = AuditEntry(seq=head.seq + 1, at=datetime.now(UTC), **act.values(outcome))
    row.hash = entry_hash(row, head.hash)
    session.add(row)
    head.seq, head.hash = row.seq, row.hash
    session.flush()


def head_of(session: Session, *, lock: bool = False) -> AuditHead:
    """Return how long the log is and the hash of its last entry."""
    return session.scalars(
        select(AuditHead).where(AuditHead.row == _ROW).with_for_update()
        if lock
        else select(AuditHead).where(AuditHead.row == _ROW)
    ).one()


def entry_hash(row: AuditEntry, hash_before: str) -> str:
    """Return SHA-256 over the hash before an entry and all that the entry says, hex."""
    said = [
        hash_before,
        row.seq,
        row.at.astimezone(UTC).isoformat(timespec="microseconds"),
        row.key_id,
        row.action,
        row.subject,
        row.map_slug,
        row.detail,
        row.outcome,
    ]
    return hashlib.sha256(json.dumps(said, separators=(",", ":")).encode()).hexdigest()
