"""Loaded revisions, which answer queries."""

import threading
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from app.loading import Loading
from core.encodings.signature import REVISION_PREFIX_BYTES
from core.errors import StaleSignature
from core.localization.localizer import Localizer
from core.mapping.anchor import Anchor
from core.mapping.georeference import Georeference
from storage.catalog import MapRecord
from storage.errors import (
    AmbiguousRevision,
    NoLiveRevision,
    RevisionNotFound,
    StorageBusy,
)
from storage.store import Store

_ATTEMPTS = 20


@dataclass(frozen=True)
class Answering:
    """A revision that answers, and the one that is live.

    Attributes:
        localizer: The localizer of the revision that answers.
        live_revision: Digest of the live one.
        anchor: The map's anchor, `None` without one.
    """

    localizer: Localizer
    live_revision: str
    anchor: Anchor | None = None

    @property
    def georeference(self) -> Georeference:
        """Where the drives of the revision that answers are on the Earth."""
        return Georeference(self.anchor, self.localizer.map.drives_aside)


class LoadedRevisions:
    """A cache of the revisions used last.

    Args:
        store: The store with the revisions' files.
        limit: How many are kept.
    """

    def __init__(self, store: Store, limit: int) -> None:
        self._store = store
        self._limit = limit
        self._loaded: OrderedDict[tuple[str, str], Localizer] = OrderedDict()
        self._lock = threading.Lock()
        self._reading = Loading(self._kept)

    def get(self, map_slug: str, revision: str | None) -> Answering:
        """Return the revision of that name, without one the live one; see `named` and `live`."""
        return self.live(map_slug) if revision is None else self.named(map_slug, revision)

    def live(self, map_slug: str, *, keep: bool = True) -> Answering:
        """Return the live revision of a map.

        Args:
            map_slug: The map.
            keep: Whether it is kept if it was not, instead of the one used longest ago.

        Raises:
            MapNotFound: If there is no such map.
            NoLiveRevision: If the map has no revision yet.
            CorruptFile: If its file is damaged.
            StorageBusy: If another one becomes live, and this one is removed, in each attempt.
        """
        for _ in range(_ATTEMPTS):
            of_map, live = self._live(map_slug)
            with suppress(RevisionNotFound):  # another one became live, and this one was removed
                return Answering(
                    self._get(map_slug, of_map.id, live, keep=keep), live, of_map.anchor
                )
        raise StorageBusy(f"another revision of {map_slug!r} became live {_ATTEMPTS} times")

    def named(self, map_slug: str, revision: str) -> Answering:
        """Return a retained revision by its digest or a prefix of at least 12 digits.

        Raises:
            MapNotFound: If there is no such map.
            NoLiveRevision: If the map has no revision yet.
            RevisionNotFound: If the map has no such revision, or it was removed.
            AmbiguousRevision: If the map has several.
            CorruptFile: If its file is damaged.
        """
        of_map, live = self._live(map_slug)
        digest = self._store.revisions.get(map_slug, revision).digest
        return Answering(self._get(map_slug, of_map.id, digest), live, of_map.anchor)

    def of_signature(self, map_slug: str, revision: str) -> Answering:
        """Return the revision for signatures that name a basis or a revision.

        For a basis that is the live revision if it has the basis, else the newest retained one
        that has it.

        Args:
            map_slug: The map.
            revision: Digest of the basis or revision, or at least 16 first digits.

        Raises:
            MapNotFound: If there is no such map.
            NoLiveRevision: If the map has no revision yet.
            StaleSignature: If no retained revision has that name or basis; names the live one.
            CorruptFile: If its file is damaged.
        """

        def names() -> tuple[MapRecord, str, str]:
            answering = self._of_signature(map_slug, revision)
            of_map, live = self._live(map_slug)
            return of_map, answering.localizer.map.revision, live

        of_map, digest, live = self._store.catalog.kept_by_digest(
            ("of signature", map_slug), revision, names
        )
        try:
            return Answering(self._get(map_slug, of_map.id, digest), live, of_map.anchor)
        except RevisionNotFound:  # removed meanwhile
            return self._of_signature(map_slug, revision)

    def _of_signature(self, map_slug: str, revision: str) -> Answering:
        _, live = self._live(map_slug)
        stale = StaleSignature(
            f"map {map_slug!r} has no revision or basis {revision[:64] or '(none)'!r}, or no"
            f" longer; live is {live}"
        )
        if len(revision) < 2 * REVISION_PREFIX_BYTES:
            raise stale
        for _ in range(_ATTEMPTS):
            holder = self._store.revisions.with_basis(map_slug, revision)
            if holder is None:
                break
            with suppress(RevisionNotFound):  # removed meanwhile; another may have the basis
                return self.named(map_slug, holder.digest)
        try:
            return self.named(map_slug, revision)
        except (RevisionNotFound, AmbiguousRevision):
            # The catalog has no bases of revisions that an early version built.
            answering = self.live(map_slug)
            if answering.localizer.answers(revision):
                return answering
            raise stale from None

    def _live(self, map_slug: str) -> tuple[MapRecord, str]:
        record = self._store.maps.get(map_slug)
        if record.live_revision is None:
            raise NoLiveRevision(f"map {map_slug!r} has no revision yet: post a build")
        return record, record.live_revision

    def _get(self, map_slug: str, map_id: str, digest: str, *, keep: bool = True) -> Localizer:
        key = (map_id, digest)
        localizer = self._reading.get(key, partial(self._load, map_slug, key, keep=keep))
        if keep:
            with self._lock, suppress(KeyError):
                self._loaded.move_to_end(key)
        return localizer

    def _kept(self, key: tuple[str, str]) -> Localizer | None:
        with self._lock:
            return self._loaded.get(key)

    def _load(self, map_slug: str, key: tuple[str, str], *, keep: bool) -> Localizer:
        record = self._store.revisions.get(map_slug, key[1])
        localizer = Localizer(self._store.revisions.read(record))
        if keep:
            with self._lock:
                self._loaded[key] = localizer
                while len(self._loaded) > self._limit:
                    self._loaded.popitem(last=False)
        return localizer
