"""The audit log: who changed what and when, append-only."""

from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, Select, func, select, union_all
from sqlalchemy.orm import Session

from core.errors import InvalidParameters
from storage.catalog.acts import Act, on_behalf
from storage.catalog.audit_chain import append, entry_hash
from storage.catalog.database import Repository
from storage.catalog.models import AuditHead, AuditRecord
from storage.catalog.pages import DEFAULT_LIMIT, one_more, page_of
from storage.catalog.records import Page

_BATCH = 1000
_FEW = 10_000
_AFTER_ALL = 2**63 - 1


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
        actions: Collection[str] = (),
        since: datetime | None = None,
        until: datetime | None = None,
        newest_first: bool = False,
    ) -> Page[AuditRecord]:
        """Return a page of the entries, oldest first.

        A cursor is a place: it is good in either order, with any filter, and while entries are
        added, which newest first are before the first page.

        Args:
            after: The place after which, in the order of the list, the page begins; 0 for the first
                page.
            limit: Number of entries in a page.
            map_slug: Only those about this map.
            key_id: Only those of this key.
            actions: Only those with one of these; empty for all.
            since: Only those at this time or later.
            until: Only those before this time.
            newest_first: Whether the newest entry is the first.
        """
        wanted: list[ColumnElement[bool]] = []
        if map_slug is not None:
            wanted.append(AuditRecord.map_slug == map_slug)
        if key_id is not None:
            wanted.append(AuditRecord.key_id == key_id)
        if since is not None:
            wanted.append(AuditRecord.at >= since)
        if until is not None:
            wanted.append(AuditRecord.at < until)
        with self._database.reading() as session:
            if newest_first:
                places = _places_from_the_end(session, after, since, until)
            else:
                places = _places(session, after, since)
            query = _listed([*wanted, *places], actions, one_more(limit), newest_first=newest_first)
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
            head = session.scalars(select(AuditHead)).one_or_none()
            if head is None:
                return AuditCheck(good, "the head of the log is gone")
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
            # The last entry before the head again, which then is not behind it.
            last = session.scalar(select(func.max(AuditRecord.seq))) or 0
            written = session.scalar(select(AuditHead.seq)) or 0
        if (head.seq, head.hash) != (good.seq, good.hash):
            return AuditCheck(good, f"the log had {head.seq} entries, {good.seq} are left")
        if last > written:
            return AuditCheck(good, f"entry {last} follows the last one that was written")
        if known is not None and known.seq > good.seq:
            return AuditCheck(good, f"entry {known.seq} was known, {good.seq} are left")
        return AuditCheck(good, None)


def _listed(
    wanted: Sequence[ColumnElement[bool]],
    actions: Collection[str],
    most: int,
    *,
    newest_first: bool,
) -> Select[AuditRecord]:
    """Return the query of the first `most` entries with one of some actions.

    Each action has its own, which ends at `most`: databases would sort all that one query of
    several actions finds.
    """
    order = AuditRecord.seq.desc() if newest_first else AuditRecord.seq
    if actions:
        each = [
            select(AuditRecord.seq)
            .where(AuditRecord.action == action, *wanted)
            .order_by(order)
            .limit(most)
            .subquery()
            for action in sorted(set(actions))
        ]
        wanted = [AuditRecord.seq.in_(union_all(*(select(one.c.seq) for one in each)))]
    return select(AuditRecord).where(*wanted).order_by(order).limit(most)


def _places(session: Session, after: int, since: datetime | None) -> list[ColumnElement[bool]]:
    """Return which places a page can have, oldest first."""
    if since is not None and not after:  # later pages begin among these
        # Not plain `seq`: databases would go through the log from its start, in its order.
        # Not that with the least time: a clock that was set back lets times decrease.
        query = select(func.min(AuditRecord.seq + 0)).where(AuditRecord.at >= since)
        first = session.scalar(query)
        after = _AFTER_ALL if first is None else first - 1
    return [AuditRecord.seq > after]


def _places_from_the_end(
    session: Session, after: int, since: datetime | None, until: datetime | None
) -> list[ColumnElement[bool]]:
    """Return which places a page can have, newest first."""
    if until is not None and not after:
        query = select(func.max(AuditRecord.seq + 0)).where(AuditRecord.at < until)
        after = (session.scalar(query) or 0) + 1
    places = [AuditRecord.seq < (after or _AFTER_ALL)]
    if since is not None:
        # Without a first place the last page would go through the log to its start. To look for it
        # on each page costs as much as there are entries, so it is looked for among few only.
        newest = select(AuditRecord.seq).where(AuditRecord.at >= since).order_by(AuditRecord.at)
        few = newest.limit(_FEW + 1).subquery()
        count, first = session.execute(select(func.count(), func.min(few.c.seq))).one()
        if count <= _FEW:
            places.append(AuditRecord.seq >= (_AFTER_ALL if first is None else first))
    return places
