"""Tokens in the catalog, each obtained in exchange for a key."""

from collections.abc import Iterable
from datetime import UTC, datetime

from sqlalchemy import delete, select

from storage.catalog.database import Repository
from storage.catalog.models import KeyRecord, TokenRecord


class Tokens(Repository):
    """The tokens; expired ones are removed when one is added."""

    def add(
        self,
        token_id: str,
        secret_hash: str,
        key_hash: str,
        scopes: Iterable[str],
        maps: Iterable[str] | None,
        expires_at: datetime,
    ) -> TokenRecord:
        """Store a token by the hash of its secret."""
        now = datetime.now(UTC)
        token = TokenRecord(
            id=token_id,
            secret_hash=secret_hash,
            key_hash=key_hash,
            scopes=sorted(set(scopes)),
            maps=None if maps is None else sorted(set(maps)),
            created_at=now,
            expires_at=expires_at,
        )
        with self._database.writing() as session:
            session.execute(delete(TokenRecord).where(TokenRecord.expires_at <= now))
            session.add(token)
        return token

    def with_hash(self, secret_hash: str) -> tuple[TokenRecord, KeyRecord | None] | None:
        """Return the token of that hash and its key, `None` if there is no such token.

        The key is `None` if the catalog does not have it: it may be that of the settings.
        """
        query = (
            select(TokenRecord, KeyRecord)
            .outerjoin(KeyRecord, KeyRecord.secret_hash == TokenRecord.key_hash)
            .where(TokenRecord.secret_hash == secret_hash)
        )

        def read() -> tuple[TokenRecord, KeyRecord | None] | None:
            with self._database.reading() as session:
                found = session.execute(query).one_or_none()
                return None if found is None else (found[0], found[1])

        return self._database.kept.get(("token", secret_hash), read)
