"""The audit log: who changed what and when, append-only."""

from contextlib import closing
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from core.errors import InvalidParameters
from storage.catalog.acts import Act, on_behalf
from storage.catalog.audit_chain import append, entry_hash, head_of
from storage.catalog.database import Repository
from storage.catalog.models import AuditRecord
from storage.catalog.pages import DEFAULT_LIMIT, one_more, page_of
from storage.catalog.records import Page

_BATCH = 1000


@dataclass(frozen=True)
class AuditState:
    """Length of the log, and the hash of its last entry.

    A state that is stored elsewhere shows later whether the log up to it is unchanged.
    """

    seq: int
    hash: str

    def __post_init__(self) -> None:
        if self.seq < 0 or len(self.hash) != 64:
            raise InvalidParameters(
                f"wanted a number of entries and 64 hex digits, got {self.seq} and"
                f" {self.hash[:80]!r}"
            )


START = AuditState(0, "0" * 64)


@dataclass(frozen=True)
class AuditCheck:
    """Whether the log is what was written.

    Attributes:
        state: Up to which entry it is intact.
        fault: What is wrong after that, `None` if nothing is.
    """

    state: AuditState
    fault: str | None


class Audit(Repository):
    """The entries, in the order in which they were written."""

    def append(self, act: Act, outcome: str) -> None:
        """Add an entry about an act that was rejected or failed, or changed no row of the catalog.

        What it changed before has its own.
        """
        with on_behalf(None), self._database.writing(announced=False) as session:
            append(session, act, outcome)

    def list(
        self,
        after: int = 0,
        limit: int = DEFAULT_LIMIT,
        *,
        map_slug: str | None = None,
        key_id: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
    ) -> Page[AuditRecord]:
        """Return the entries after place `after`, oldest first.

        Args:
            after: A place.
            limit: Number of entries in a page.
            map_slug: Only those about this map.
            key_id: Only those of this key.
            since: Only those at this time or later.
            until: Only those before this time.
        """
        query = select(AuditRecord)
        if map_slug is not None:
            query = query.where(AuditRecord.map_slug == map_slug)
        if key_id is not None:
            query = query.where(AuditRecord.key_id == key_id)
        if since is not None:
            query = query.where(AuditRecord.at >= since)
        if until is not None:
            query = query.where(AuditRecord.at < until)
        query = query.order_by(AuditRecord.seq).limit(one_more(limit))
        with self._database.reading() as session:
            if since is not None and not after:  # later pages begin among these
                first = _first_at(session, since)
                if first is None:
                    return Page((), None)
                after = first - 1
            query = query.where(AuditRecord.seq > after)
            return page_of(session.scalars(query).all(), limit, lambda row: str(row.seq))

    def verify(self, known: AuditState | None = None) -> AuditCheck:
        """Recompute the whole chain.

        A changed, removed, inserted or moved entry breaks it; a removed last entry does not match
        the head. Who can write the database can recompute all of it, head included: only `known`,
        stored elsewhere, detects that.

        Args:
            known: A state that the log once had.
        """
        good = START
        with self._database.reading() as session:
            # First: where readers have no snapshot, entries that are added meanwhile come after.
            head = head_of(session)
            rows = session.scalars(
                select(AuditRecord)
                .where(AuditRecord.seq <= head.seq)
                .order_by(AuditRecord.seq)
                .execution_options(yield_per=_BATCH)
            )
            with closing(rows):  # a fault ends it early
                for row in rows:
                    if row.seq != good.seq + 1:
                        return AuditCheck(good, f"entry {good.seq + 1} is gone; {row.seq} follows")
                    if row.hash != entry_hash(row, good.hash):
                        return AuditCheck(good, f"entry {row.seq} is not what was written")
                    good = AuditState(row.seq, row.hash)
                    if known is not None and known.seq == good.seq and known != good:
                        return AuditCheck(good, f"entry {row.seq} is not the one that was known")
        if (head.seq, head.hash) != (good.seq, good.hash):
            return AuditCheck(good, f"the log had {head.seq} entries, {good.seq} are left")
        if known is not None and known.seq > good.seq:
            return AuditCheck(good, f"entry {known.seq} was known, {good.seq} are left")
        return AuditCheck(good, None)


def _first_at(session: Session, since: datetime) -> int | None:
    """Return the place of the first entry at this time or later.

    Not of that with the least time: a clock that was set back lets times decrease.
    """
    # Not plain `seq`: databases would go through the log from its start, in its order.
    return session.scalar(select(func.min(AuditRecord.seq + 0)).where(AuditRecord.at >= since))
