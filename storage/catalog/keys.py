"""API keys in the catalog: hashes of secrets, and what they allow."""

from collections.abc import Iterable
from datetime import UTC, datetime

from sqlalchemy import select, tuple_
from sqlalchemy.orm import Session

from core.errors import InvalidParameters
from storage.catalog.database import Database
from storage.catalog.models import Key
from storage.catalog.pages import DEFAULT_LIMIT, one_more, page_of
from storage.catalog.records import KeyRecord, Page
from storage.errors import KeyNotFound
from storage.names import new_id

__all__ = ["Keys", "key_record"]


class Keys:
    """The keys, in the order in which they were made."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(
        self,
        secret_hash: str,
        scopes: Iterable[str],
        *,
        key_id: str | None = None,
        name: str = "",
        maps: Iterable[str] | None = None,
        expires_at: datetime | None = None,
        first_run: bool = False,
    ) -> KeyRecord:
        """Store a key by the hash of its secret.

        Args:
            secret_hash: SHA-256 of the key as it is sent.
            scopes: What it allows.
            key_id: Its id; a new one if not given.
            name: What it is called.
            maps: The slugs it is limited to; all maps if not given.
            expires_at: When it ends; never if not given.
            first_run: Whether the service makes it for its administrator.
        """
        with self._database.writing() as session:
            row = Key(
                id=key_id or new_id(),
                name=name,
                secret_hash=secret_hash,
                scopes=sorted(set(scopes)),
                maps=None if maps is None else sorted(set(maps)),
                first_run=first_run,
                created_at=datetime.now(UTC),
                expires_at=expires_at,
            )
            session.add(row)
            session.flush()
            return key_record(row)

    def get(self, key_id: str) -> KeyRecord:
        """Return a key, a revoked one too.

        Raises:
            KeyNotFound: If there is none of that id.
        """
        with self._database.reading() as session:
            return key_record(_found(session, key_id))

    def with_hash(self, secret_hash: str) -> KeyRecord | None:
        """Return the key of that hash, a revoked one too; `None` if there is none."""
        with self._database.reading() as session:
            row = session.scalar(select(Key).where(Key.secret_hash == secret_hash))
            return None if row is None else key_record(row)

    def ever_made(self) -> bool:
        """Return whether there is any key, or was: a revoked one stays in the list."""
        with self._database.reading() as session:
            return session.scalar(select(Key.id).limit(1)) is not None

    def list(self, after: str = "", limit: int = DEFAULT_LIMIT) -> Page[KeyRecord]:
        """Return the keys that were made after key `after`, the revoked ones too.

        Raises:
            InvalidParameters: If `after` is no key.
        """
        query = select(Key).order_by(Key.created_at, Key.id).limit(one_more(limit))
        with self._database.reading() as session:
            if after:
                last = session.get(Key, after)
                if last is None:
                    raise InvalidParameters(f"the cursor {after[:80]!r} is no key")
                query = query.where(
                    tuple_(Key.created_at, Key.id) > tuple_(last.created_at, last.id)
                )
            records = [key_record(row) for row in session.scalars(query)]
        return page_of(records, limit, lambda record: record.id)

    def revoke(self, key_id: str) -> KeyRecord:
        """Let a key open nothing any more; a revoked one keeps its time.

        Raises:
            KeyNotFound: If there is none of that id.
        """
        with self._database.writing() as session:
            row = _found(session, key_id)
            row.revoked_at = row.revoked_at or datetime.now(UTC)
            session.flush()
            return key_record(row)


def key_record(row: Key) -> KeyRecord:
    """Return the record of a key's row."""
    return KeyRecord(
        id=row.id,
        name=row.name,
        secret_hash=row.secret_hash,
        scopes=tuple(row.scopes),
        maps=None if row.maps is None else tuple(row.maps),
        first_run=row.first_run,
        created_at=row.created_at,
        expires_at=row.expires_at,
        revoked_at=row.revoked_at,
    )


def _found(session: Session, key_id: str) -> Key:
    row = session.get(Key, key_id)
    if row is None:
        raise KeyNotFound(f"there is no key {key_id[:80]!r}")
    return row
