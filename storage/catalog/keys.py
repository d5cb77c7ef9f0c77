"""API keys in the catalog: hashes of secrets, and what they allow."""

from collections.abc import Iterable
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from storage.catalog import audit_chain
from storage.catalog.database import Repository
from storage.catalog.models import KeyRecord
from storage.catalog.pages import DEFAULT_LIMIT, page_by_age
from storage.catalog.records import Page
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
            key_id: The key's id; a new one by default.
            name: What it is called.
            maps: The slugs it is limited to; all maps by default.
            expires_at: When it ends; never by default.
            first_run: Whether the service makes it for its administrator.
        """
        key = KeyRecord(
            id=key_id or new_id(),
            name=name,
            secret_hash=secret_hash,
            scopes=sorted(set(scopes)),
            maps=None if maps is None else sorted(set(maps)),
            first_run=first_run,
            created_at=datetime.now(UTC),
            expires_at=expires_at,
        )
        with self._database.writing() as session:
            session.add(key)
        return key

    def get(self, key_id: str) -> KeyRecord:
        """Return a key, also a revoked one.

        Raises:
            KeyNotFound: If there is none of that id.
        """
        with self._database.reading() as session:
            return _found(session, key_id)

    def with_hash(self, secret_hash: str) -> KeyRecord | None:
        """Return the key of that hash, also a revoked one; `None` if there is none."""

        def read() -> KeyRecord | None:
            with self._database.reading() as session:
                return session.scalar(select(KeyRecord).where(KeyRecord.secret_hash == secret_hash))

        return self._database.kept.get(("key", secret_hash), read)

    def ever_made(self) -> bool:
        """Return whether there is any key, revoked ones included."""

        def read() -> bool:
            with self._database.reading() as session:
                return session.scalar(select(KeyRecord.id).limit(1)) is not None

        return self._database.kept.get(("keys",), read)

    def list(self, after: str = "", limit: int = DEFAULT_LIMIT) -> Page[KeyRecord]:
        """Return the keys that were made after key `after`, revoked ones included.

        Raises:
            InvalidParameters: If `after` is no cursor of such a list.
        """
        with self._database.reading() as session:
            name = KeyRecord.id
            return page_by_age(session, select(KeyRecord), name, after, limit, newest_first=False)

    def revoke(self, key_id: str) -> KeyRecord:
        """Make a key invalid; one that was revoked before keeps its time.

        Raises:
            KeyNotFound: If there is none of that id.
        """
        with self._database.writing() as session:
            key = _found(session, key_id)
            key.revoked_at = key.revoked_at or datetime.now(UTC)
            audit_chain.omit_if_unchanged(session, key)
            return key


def _found(session: Session, key_id: str) -> KeyRecord:
    key = session.get(KeyRecord, key_id)
    if key is None:
        raise KeyNotFound(f"there is no key {key_id[:80]!r}")
    return key
