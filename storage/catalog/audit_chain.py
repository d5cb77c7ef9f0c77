"""The chain of the audit log: each entry's hash covers the entry and the hash before it."""

import hashlib
import json
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from storage.catalog.acts import Act
from storage.catalog.models import AuditHead, AuditRecord

DONE = "done"
_MOST_CHARACTERS = 300


def append(session: Session, act: Act, outcome: str) -> None:
    """Add an entry within the caller's transaction; two never get the same place."""
    head = head_of(session, lock=True)
    row = AuditRecord(
        seq=head.seq + 1,
        at=datetime.now(UTC),
        key_id=act.key_id,
        action=act.action[:_MOST_CHARACTERS],
        subject=act.subject[:_MOST_CHARACTERS],
        map_slug=act.map_slug,
        detail=act.detail[:_MOST_CHARACTERS],
        outcome=outcome,
    )
    row.hash = entry_hash(row, head.hash)
    session.add(row)
    head.seq, head.hash = row.seq, row.hash
    session.flush()


def head_of(session: Session, *, lock: bool = False) -> AuditHead:
    """Return the length of the log and the hash of its last entry."""
    query = select(AuditHead)
    return session.scalars(query.with_for_update() if lock else query).one()


def entry_hash(row: AuditRecord, hash_before: str) -> str:
    """Return SHA-256 over the hash before an entry and all of the entry, hex."""
    content = [
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
    return hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
