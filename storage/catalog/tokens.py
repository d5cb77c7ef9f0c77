"""Tokens in the catalog: what was exchanged for a key, for a short time."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy import delete, select

from storage.catalog.database import Repository
from storage.catalog.keys import allowed, key_record
from storage.catalog.models import Key, Token
from storage.catalog.records import KeyRecord, record_of


@dataclass(frozen=True)
class TokenRecord:
    """A token; the secret itself is never stored, only its hash.

    Attributes:
        secret_hash: SHA-256 of the token as it is sent, hex.
        key_hash: That of the key that it was exchanged for: with the key it ends.
        scopes: What it allows, no more than the key.
        maps: Slugs of the maps that it is limited to, `None` for all.
        expires_at: It opens nothing from then on.
    """

    id: str
    secret_hash: str
    key_hash: str
    scopes: tuple[str, ...]
    maps: tuple[str, ...] | None
    created_at: datetime
    expires_at: datetime


class Tokens(Repository):
    """The tokens that have not ended; those that have are removed when one is added."""

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
        with self._database.writing() as session:
            session.execute(delete(Token).where(Token.expires_at <= now))
            row = Token(
                id=token_id,
                secret_hash=secret_hash,
                key_hash=key_hash,
                scopes=sorted(set(scopes)),
                maps=None if maps is None else sorted(set(maps)),
                created_at=now,
                expires_at=expires_at,
            )
            session.add(row)
            session.flush()
            return record_of(TokenRecord, row, **allowed(row))

    def with_hash(self, secret_hash: str) -> tuple[TokenRecord, KeyRecord | None] | None:
        """Return the token of that hash and its key, `None` if there is no such token.

        The key is `None` if the catalog does not have it: it may be that of the settings.
        """
        query = (
            select(Token, Key)
            .outerjoin(Key, Key.secret_hash == Token.key_hash)
            .where(Token.secret_hash == secret_hash)
        )
        with self._database.reading() as session:
            found = session.execute(query).one_or_none()
            if found is None:
                return None
            token, key = found
            record = record_of(TokenRecord, token, **allowed(token))
            return record, None if key is None else key_record(key)
