"""The audit log over the wire."""

from datetime import datetime

from pydantic import Field

from app.http.shown import Shown
from storage.catalog import AuditRecord


class AuditEntryOut(Shown):
    """A change that was asked for, and what came of it."""

    entry: int = Field(description="Its place in the log, counted from 1 without a gap.")
    at: datetime
    key: str = Field(
        description="Id of the key; `operator` for that of the settings, `everyone` without keys,"
        " `service` for what the service does by itself."
    )
    action: str = Field(examples=["make_live"])
    subject: str = Field(description="The path that was asked for.")
    map: str | None = Field(description="The map that it is about; null if about none.")
    detail: str = Field(description="What the path does not say.")
    outcome: str = Field(description="`done`, or the status that it was refused or failed with.")
    hash: str = Field(description="SHA-256 over all this and the hash of the entry before.")

    @classmethod
    def from_record(cls, record: AuditRecord) -> "AuditEntryOut":
        """Show an entry's record."""
        return cls.of(record, entry=record.seq, key=record.key_id, map=record.map_slug)
