"""API keys in the catalog: hashes of secrets, and what they allow."""

from collections.abc import Iterable
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from storage.catalog.database import Database
from storage.catalog.models import Key
from storage.catalog.records import KeyRecord
from storage.errors import KeyNotFound
from storage.names import new_id

__all__ = ["Keys"]


class Keys:
    """The keys, in the order in which they were made."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, secret_hash: str, scopes: Iterable[str]) -> KeyRecord:
        """Store a key by the hash of its secret."""
        with self._database.writing() as session:
            row = Key(
                id=new_id(),
                secret_hash=secret_hash,
                scopes=sorted(set(scopes)),
                created_at=datetime.now(UTC),
            )
            session.add(row)
            session.flush()
            return _record(row)

    def get(self, key_id: str) -> KeyRecord:
        """Return a key, a revoked one too.

        Raises:
            KeyNotFound: If there is none of that id.
        """
        with self._database.reading() as session:
            return _record(_found(session, key_id))

    def list(self) -> tuple[KeyRecord, ...]:
        """Return all keys, the revoked ones too."""
        with self._database.reading() as session:
            rows = session.scalars(select(Key).order_by(Key.created_at, Key.id))
            return tuple(_record(row) for row in rows)

    def revoke(self, key_id: str) -> KeyRecord:
        """Let a key open nothing any more; a revoked one keeps its time.

        Raises:
            KeyNotFound: If there is none of that id.
        """
        with self._database.writing() as session:
            row = _found(session, key_id)
            row.revoked_at = row.revoked_at or datetime.now(UTC)
            session.flush()
            return _record(row)


def _found(session: Session, key_id: str) -> Key:
    row = session.get(Key, key_id)
    if row is None:
        raise KeyNotFound(f"there is no key {key_id[:80]!r}")
    return row


def _record(row: Key) -> KeyRecord:
    return KeyRecord(
        id=row.id,
        secret_hash=row.secret_hash,
        scopes=tuple(row.scopes),
        created_at=row.created_at,
        revoked_at=row.revoked_at,
    )
