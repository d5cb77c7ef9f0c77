"""API keys in the catalog: hashes of secrets, and what they allow."""

from collections.abc import Iterable
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.models import Key, Token
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import KeyRecord, Page, record_of
from storage.errors import KeyNotFound
from storage.names import new_id


class Keys(Repository):
    """The keys, in the order in which they were made."""

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
        with self._database.reading() as session:
            return page_by_age(
                session, select(Key), Key.id, after, limit, key_record, newest_first=False
            )

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
    return record_of(KeyRecord, row, **allowed(row))


def allowed(row: Key | Token) -> dict[str, tuple[str, ...] | None]:
    """Return the scopes of a row, and the maps that it is limited to."""
    maps = None if row.maps is None else tuple(row.maps)
    return {"scopes": tuple(row.scopes), "maps": maps}


def _found(session: Session, key_id: str) -> Key:
    row = session.get(Key, key_id)
    if row is None:
        raise KeyNotFound(f"there is no key {key_id[:80]!r}")
    return row
