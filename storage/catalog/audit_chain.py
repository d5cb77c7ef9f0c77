"""The chain of the audit log: each entry's hash covers the entry and the hash before it."""

import hashlib
import json
from datetime import UTC, datetime

from sqlalchemy import insert, select, update
from sqlalchemy.orm import Session

from storage.catalog.acts import Act
from storage.catalog.columns import plain
from storage.catalog.models import AuditHead, AuditRecord, Base

DONE = "done"
_MOST_CHARACTERS = 300
_SHOWN = "tensormap_shown_by_the_change"
_UNCHANGED = "tensormap_unchanged"
# Of every change; as plain rows they take a third of the time of mapped objects.
_HELD_HEAD = select(AuditHead.seq, AuditHead.hash).with_for_update()
_NEW_ENTRY = insert(Base.metadata.tables["audit"])
_ENTRY = [column.key for column in Base.metadata.tables["audit"].columns]
_NEW_HEAD = update(Base.metadata.tables["audit_head"])


def add_to_detail(session: Session, text: str) -> None:
    """Add what only the change shows to the detail of the entry of this transaction."""
    session.info.setdefault(_SHOWN, []).append(text)


def omit_if_unchanged(session: Session, row: Base) -> None:
    """Make no entry of this transaction if it changes nothing of its one row.

    Entries stay for good: a request repeated in a loop would fill the disk with them. Call it
    before any query that follows the change, which would write the change first.
    """
    session.info[_UNCHANGED] = not session.is_modified(row)


def is_unchanged(session: Session) -> bool:
    """Return whether a transaction is known to change nothing."""
    return bool(session.info.get(_UNCHANGED, False))


def append(session: Session, act: Act, outcome: str) -> None:
    """Add an entry within the caller's transaction; two never get the same place."""
    session.flush()  # its own rows are locked before the head, as ever
    connection = session.connection()
    seq, hash_before = connection.execute(_HELD_HEAD).one()
    detail = ", ".join(filter(None, [act.detail, *session.info.get(_SHOWN, ())]))
    row = AuditRecord(
        seq=seq + 1,
        at=datetime.now(UTC),
        key_id=act.key_id,
        action=act.action[:_MOST_CHARACTERS],
        subject=plain(act.subject)[:_MOST_CHARACTERS],
        map_slug=act.map_slug,
        detail=plain(detail)[:_MOST_CHARACTERS],  # as it is stored, which is what is hashed
        outcome=outcome,
    )
    row.hash = entry_hash(row, hash_before)
    connection.execute(_NEW_ENTRY, {key: getattr(row, key) for key in _ENTRY})
    connection.execute(_NEW_HEAD, {"seq": row.seq, "hash": row.hash})


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
