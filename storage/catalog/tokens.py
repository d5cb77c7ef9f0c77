"""Tokens in the catalog, each obtained in exchange for a key."""

from collections.abc import Iterable
from datetime import UTC, datetime

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.key_lock import lock_key
from storage.catalog.models import KeyRecord, TokenRecord
from storage.errors import TooManyTokens


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
        *,
        most: int,
    ) -> TokenRecord:
        """Store a token by the hash of its secret.

        Args:
            token_id: The token's id.
            secret_hash: SHA-256 of the token as it is sent.
            key_hash: SHA-256 of its key.
            scopes: What it allows.
            maps: The slugs it is limited to, `None` for all maps.
            expires_at: When it ends.
            most: How many valid tokens its key may have.

        Raises:
            TooManyTokens: If the key has as many.
        """
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
        # Nothing that is kept changes: a token that was not there never is, and one that expired is
        # rejected by its time.
        with self._database.writing(announced=False) as session:
            session.execute(delete(TokenRecord).where(TokenRecord.expires_at <= now))
            lock_key(session, "tokens", key_hash)
            _require_room(session, key_hash, most)
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


def _require_room(session: Session, key_hash: str, most: int) -> None:
    of_key = TokenRecord.key_hash == key_hash
    valid, first_end = session.execute(
        select(func.count(), func.min(TokenRecord.expires_at)).where(of_key)
    ).one()
    if valid >= most:
        raise TooManyTokens(
            f"the limit of {most} valid tokens of a key is reached: use one of them, or wait until"
            f" {first_end:%Y-%m-%dT%H:%M:%SZ}, when the first expires"
        )
