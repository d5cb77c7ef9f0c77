"""Tables of keys, tokens and the audit log."""

from datetime import datetime

from sqlalchemy import (
    JSON,
    BigInteger,
    Index,
)
from sqlalchemy.orm import (
    Mapped,
    mapped_column,
)

from storage.catalog.columns import (
    Digest,
    Id,
    PlainString,
    Slug,
)
from storage.catalog.models.base import Base


class KeyRecord(Base):
    """An API key; the secret itself is never stored, only its hash.

    Attributes:
        name: What its maker calls it.
        secret_hash: SHA-256 of the whole key as it is sent, hex.
        scopes: What it allows.
        maps: Slugs of the maps that it is limited to, `None` for all; not ids: a key may be made
            before its map.
        first_run: Whether the service made it for its administrator.
        expires_at: It is invalid from then on, `None` for never.
        revoked_at: It is invalid since then.
    """

    __tablename__ = "keys"

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    name: Mapped[str] = mapped_column(PlainString(100))
    secret_hash: Mapped[str] = mapped_column(PlainString(255), unique=True)
    scopes: Mapped[list[str]] = mapped_column(JSON)
    maps: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    first_run: Mapped[bool]
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None] = mapped_column(default=None)

    def opens_at(self, moment: datetime) -> bool:
        """Return whether it is valid at a time."""
        return self.revoked_at is None and (self.expires_at is None or moment < self.expires_at)


class TokenRecord(Base):
    """A token, obtained in exchange for a key; of the secret only the hash is stored.

    Attributes:
        secret_hash: SHA-256 of the token as it is sent, hex.
        key_hash: SHA-256 of the key, whose end is the token's; not a foreign key: the key of the
            settings is in no table.
        scopes: What it allows, no more than the key.
        maps: Slugs of the maps that it is limited to, `None` for all.
        expires_at: It is invalid from then on.
    """

    __tablename__ = "tokens"
    __table_args__ = (Index("ix_tokens_key_hash_expires_at", "key_hash", "expires_at"),)

    id: Mapped[str] = mapped_column(Id, primary_key=True)
    secret_hash: Mapped[str] = mapped_column(PlainString(255), unique=True)
    key_hash: Mapped[str] = mapped_column(PlainString(255))
    scopes: Mapped[list[str]] = mapped_column(JSON)
    maps: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class AuditRecord(Base):
    """An entry of the audit log; no row is ever changed or removed.

    Attributes:
        seq: The entry's place, counted from 1 without a gap.
        key_id: Who made the change; no foreign keys: the log outlives its subjects.
        outcome: `done`, or the HTTP status of the answer to a rejected or failed request, as `403`.
        hash: SHA-256 over all this and the hash of the entry before.
    """

    __tablename__ = "audit"
    __table_args__ = (
        Index("ix_audit_key_id_seq", "key_id", "seq"),
        Index("ix_audit_map_slug_seq", "map_slug", "seq"),
        Index("ix_audit_at_seq", "at", "seq"),
        Index("ix_audit_action_seq", "action", "seq"),
    )

    seq: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    key_id: Mapped[str] = mapped_column(Id)
    action: Mapped[str] = mapped_column(PlainString(300))
    subject: Mapped[str] = mapped_column(PlainString(300))
    map_slug: Mapped[str | None] = mapped_column(Slug)
    detail: Mapped[str] = mapped_column(PlainString(300))
    outcome: Mapped[str] = mapped_column(PlainString(100))
    hash: Mapped[str] = mapped_column(Digest, default="")


class AuditHead(Base):
    """Length of the audit log and its last hash: one row, locked by each writer."""

    __tablename__ = "audit_head"

    row: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    seq: Mapped[int] = mapped_column(BigInteger)
    hash: Mapped[str] = mapped_column(Digest)
