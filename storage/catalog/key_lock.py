"""One transaction at a time that counts what a key has and adds to it."""

from hashlib import blake2b

from sqlalchemy import text
from sqlalchemy.orm import Session


def lock_key(session: Session, noun: str, key: str | None) -> None:
    """Let no other transaction count the key's rows of this noun before this one ends.

    On PostgreSQL both would see the same count, and both add. SQLite has one writer anyway.
    """
    if session.get_bind().dialect.name == "postgresql":
        name = f"{noun} {key or ''}".encode()
        number = int.from_bytes(blake2b(name, digest_size=8).digest(), "big", signed=True)
        session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": number})
