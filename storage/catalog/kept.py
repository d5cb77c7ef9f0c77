"""What was read from the catalog, kept in memory until anything in it changes."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from core.encodings.signature import REVISION_PREFIX_BYTES
from storage.catalog.changes import Changes

T = TypeVar("T")

_MOST = 10_000  # records; all are dropped at the next one
_KEPT_DIGITS = {2 * REVISION_PREFIX_BYTES, 64}  # in hex


class NotKept(Exception):
    """A query is needed, within a block that must not make one."""


class Kept:
    """Records by name, of one state of the catalog; safe to share between threads.

    Without `watch` nothing is kept: a command reads what it needs.
    """

    def __init__(self) -> None:
        self._changes: Changes | None = None
        self._of: tuple[int | None, dict[tuple[str, ...], Any]] = (None, {})
        self._forbidden = threading.local()

    def watch(self, changes: Changes | None) -> None:
        """Keep what is read from now on."""
        self._changes = changes

    def get(self, name: tuple[str, ...], read: Callable[[], T]) -> T:
        """Return what is kept of that name, or what `read` returns, which is then kept.

        `None` is not kept: anybody could ask for as many names as they like.
        """
        changes = self._changes
        version = None if changes is None else changes.version()
        if version is None:
            return read()
        of, records = self._of
        if of == version and name in records:
            found: T = records[name]
            return found
        value = read()
        if value is not None:
            # The version is of before the read: a change in between shows at the next look.
            of, records = self._of
            if of != version or len(records) >= _MOST:
                self._of = (version, {name: value})
            else:
                records[name] = value
        return value

    def by_digest(self, name: tuple[str, ...], digest: str, read: Callable[[], T]) -> T:
        """Return what is kept of a digest, however it is spelt, or what `read` returns.

        That is kept of whole digests and of as much of one as packed signatures carry. Of any
        length and case, names of one record could take the place of all others.
        """
        if len(digest) not in _KEPT_DIGITS:
            return read()
        return self.get((*name, digest.lower()), read)

    def changed(self) -> None:
        """Note that this process committed a change."""
        if self._changes is not None:
            self._changes.changed()

    @contextmanager
    def only(self) -> Iterator[None]:
        """Raise `NotKept` within the block, in this thread, instead of making a query."""
        self._forbidden.set = True
        try:
            yield
        finally:
            self._forbidden.set = False

    def require_query(self) -> None:
        """Raise `NotKept` within a block that must not make a query."""
        if getattr(self._forbidden, "set", False):
            raise NotKept

    def close(self) -> None:
        """Stop watching."""
        if self._changes is not None:
            self._changes.close()
            self._changes = None
