"""All maps with what they answer from, for queries that name no map."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

from sqlalchemy import and_, select

from storage.catalog.database import Repository
from storage.catalog.models import BasisRecord, LiveRevision, Map, RevisionBasis, RevisionRecord
from storage.names import RECYCLED

MOST_LIMITS = 64
"""Of so many keys with different maps the selections are kept."""


@dataclass(frozen=True)
class MapSummary:
    """A map, and its live revision if it has one.

    Attributes:
        map_id: The map's id.
        slug: The map's name.
        revision: Digest of the live revision, `None` before the first.
        file_name: The name of that revision's file, empty without one.
        scans: The number of its scans.
        basis: Digest of the shared basis that it has, `None` if it has none.
    """

    map_id: str
    slug: str
    revision: str | None
    file_name: str
    scans: int
    basis: str | None


class MapSummaries(Repository):
    """All maps, in the order of their slugs."""

    def all(self, slugs: Collection[str] | None = None) -> Sequence[MapSummary]:
        """Return all maps, only those of `slugs` if given, in a time that depends on these.

        While the catalog is kept in memory and did not change, it is the same object for the same
        slugs.
        """
        if slugs is None:
            return self._all()
        limited = self._database.kept.get(
            ("map summaries of slugs",), lambda: _by_slugs(self._all())
        )
        return limited(frozenset(slugs))

    def _all(self) -> tuple[MapSummary, ...]:
        def read() -> tuple[MapSummary, ...]:
            shared = (
                select(RevisionBasis.map_id, RevisionBasis.digest, RevisionBasis.basis)
                .join(BasisRecord, BasisRecord.digest == RevisionBasis.basis)
                .subquery()
            )
            query = (
                select(
                    Map.id,
                    Map.slug,
                    LiveRevision.digest,
                    RevisionRecord.file_name,
                    RevisionRecord.scans,
                    shared.c.basis,
                )
                .outerjoin(LiveRevision, LiveRevision.map_id == Map.id)
                .outerjoin(
                    RevisionRecord,
                    and_(
                        RevisionRecord.map_id == Map.id,
                        RevisionRecord.digest == LiveRevision.digest,
                    ),
                )
                .outerjoin(
                    shared, and_(shared.c.map_id == Map.id, shared.c.digest == LiveRevision.digest)
                )
                .where(Map.slug < RECYCLED)
                .order_by(Map.slug)
            )
            with self._database.reading() as session:
                rows = session.execute(query).all()
            return tuple(
                MapSummary(map_id, slug, digest, file_name or "", scans or 0, basis)
                for map_id, slug, digest, file_name, scans, basis in rows
            )

        return self._database.kept.get(("map summaries",), read)

    def with_basis(self, named: str) -> frozenset[str]:
        """Return the ids of the maps whose live revision has a basis.

        Args:
            named: Digest of the basis, or its first digits.
        """

        def read() -> frozenset[str] | None:
            begins = RevisionBasis.basis.startswith(named.lower(), autoescape=True)
            query = (
                select(LiveRevision.map_id)
                .join(
                    RevisionBasis,
                    and_(
                        RevisionBasis.map_id == LiveRevision.map_id,
                        RevisionBasis.digest == LiveRevision.digest,
                    ),
                )
                .where(begins)
            )
            with self._database.reading() as session:
                # `None` is not kept: anybody could send as many names as they like.
                return frozenset(session.scalars(query)) or None

        kept = self._database.kept.by_digest(("maps with basis",), named, read)
        return kept or frozenset()


def _by_slugs(
    maps: Sequence[MapSummary],
) -> Callable[[frozenset[str]], Sequence[MapSummary]]:
    """Return a function that returns those of the maps that have some slugs, and keeps a few."""
    by_slug = {summary.slug: summary for summary in maps}

    @lru_cache(MOST_LIMITS)
    def limited(slugs: frozenset[str]) -> Sequence[MapSummary]:
        return tuple(by_slug[slug] for slug in sorted(slugs) if slug in by_slug)

    return limited
