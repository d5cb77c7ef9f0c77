"""Shared bases in the catalog."""

from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from storage.catalog.database import Repository
from storage.catalog.models import OPEN_STATES, PURGED, BasisRecord, JobRecord, RevisionBasis
from storage.catalog.pages import DEFAULT_LIMIT, one_more, page_of
from storage.catalog.records import Page
from storage.errors import BasisExists, BasisInUse, BasisNotFound
from storage.names import FEWEST_DIGITS, checked_slug

_HEX_DIGITS = set("0123456789abcdef")


class Bases(Repository):
    """The shared bases, in the order of their names."""

    def add(
        self, name: str, digest: str, file_name: str, encoding: str, size_bytes: int
    ) -> BasisRecord:
        """Add a basis whose file is on disk; one that has this name already keeps its record.

        Raises:
            InvalidSlug: If `name` is not a valid slug.
            BasisExists: If another basis has the name, or this one has another name.
        """
        checked_slug(name)
        row = BasisRecord(digest, name, file_name, encoding, size_bytes, datetime.now(UTC))
        try:
            return self._add(row)
        except IntegrityError:  # on databases with concurrent writers: another one added one
            return self._add(row)

    def _add(self, row: BasisRecord) -> BasisRecord:
        is_known = (BasisRecord.name == row.name) | (BasisRecord.digest == row.digest)
        with self._database.writing() as session:
            for known in session.scalars(select(BasisRecord).where(is_known)):
                if (known.name, known.digest) == (row.name, row.digest):
                    return known
                raise BasisExists(
                    f"there is already a shared basis {known.name!r} of digest {known.digest[:12]}"
                )
            session.add(row)
        return row

    def get(self, named: str) -> BasisRecord:
        """Return a basis by its name, its digest or at least 12 first digits of that.

        Raises:
            BasisNotFound: If there is none.
        """

        def read() -> BasisRecord:
            with self._database.reading() as session:
                return _found(session, named)

        kept = self._database.kept
        if set(named.lower()) <= _HEX_DIGITS:
            return kept.by_digest(("shared basis",), named, read)
        return kept.get(("shared basis", named), read)

    def list(self, after: str = "", limit: int = DEFAULT_LIMIT) -> Page[BasisRecord]:
        """Return the bases whose names come after `after`."""
        query = select(BasisRecord).where(BasisRecord.name > after).order_by(BasisRecord.name)
        with self._database.reading() as session:
            rows = session.scalars(query.limit(one_more(limit))).all()
        return page_of(rows, limit, lambda record: record.name)

    def delete(self, named: str) -> BasisRecord:
        """Remove a basis that no revision and no open job uses; return its record.

        Raises:
            BasisNotFound: If there is none.
            BasisInUse: If a revision has it, or a queued or running job will use it.
        """
        with self._database.writing() as session:
            row = _found(session, named)
            # The jobs first: the second query finds the revision of a build that ends meanwhile.
            plans = session.scalars(select(JobRecord.plan).where(JobRecord.state.in_(OPEN_STATES)))
            if any((plan or {}).get("basis") == row.digest for plan in plans):
                raise BasisInUse(f"a queued or running build uses the shared basis {row.name!r}")
            used = session.scalar(
                select(RevisionBasis.digest)
                .where(RevisionBasis.basis == row.digest, RevisionBasis.map_id.not_in(PURGED))
                .limit(1)
            )
            if used is not None:
                raise BasisInUse(f"revisions have the shared basis {row.name!r}")
            session.delete(row)
            return row

    def files(self) -> dict[str, str]:
        """Return the digests of all bases by the names of their files."""
        with self._database.reading() as session:
            return dict(session.execute(select(BasisRecord.file_name, BasisRecord.digest)).all())


def _found(session: Session, named: str) -> BasisRecord:
    row = session.scalar(select(BasisRecord).where(BasisRecord.name == named))
    if row is None and len(named) >= FEWEST_DIGITS:
        begins = BasisRecord.digest.startswith(named.lower(), autoescape=True)
        row = session.scalar(select(BasisRecord).where(begins).order_by(BasisRecord.digest))
    if row is None:
        raise BasisNotFound(f"there is no shared basis {named[:80]!r}")
    return row
