"""Purges of maps and drives: their rows, batch by batch, and then their files."""

import logging
import shutil
import threading
import time

from storage.catalog import Catalog, Purge, RecycledRecord, on_behalf
from storage.errors import StorageError, with_cause
from storage.store.layout import Layout

_PAUSE = 0.5  # of the time that a batch took: in it those write who wait for the database

_log = logging.getLogger("tensormap.storage")


class Purges:
    """Removes what is purged. What is left after an error or a crash, the collector removes."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self._stopping = threading.Event()

    def stop(self) -> None:
        """End each purge, of any thread, after its batch; the next start goes on with it."""
        self._stopping.set()

    def finish(self, entry: RecycledRecord) -> None:
        """Remove all that is left of an entry whose purge has begun, or log why it is left."""
        drive_id = None if entry.drive_slug is None else entry.id
        self._finish(Purge(entry.id, entry.map_id, drive_id))

    def finish_all(self) -> None:
        """Remove all that is left of all purges, or log why it is left."""
        for purge in self._catalog.purges.begun():
            if not self._stopping.is_set():
                self._finish(purge)

    def _finish(self, purge: Purge) -> None:
        what = "map" if purge.drive_id is None else "drive"
        try:
            with on_behalf(None):  # the log has the act since the purge began
                if self._remove(purge):
                    _log.info("the purge of %s %s has ended", what, purge.id)
                else:
                    _log.info("a stop interrupts the purge of %s %s", what, purge.id)
        except StorageError as error:
            _log.warning(
                "what is left of the purged %s %s will be removed later: %s",
                what,
                purge.id,
                with_cause(error),
            )

    def _remove(self, purge: Purge) -> bool:
        """Remove rows, then files, then the last row; return whether no stop interrupted that.

        A start finds the files under a row until they are gone, and leaves them to the collector.
        """
        began_s = time.monotonic()
        while self._catalog.purges.remove_some(purge):
            if self._stopping.wait(_PAUSE * (time.monotonic() - began_s)):
                return False
            began_s = time.monotonic()
        if purge.drive_id is None:
            folder = self._layout.map(purge.map_id)
        else:
            folder = self._layout.drive(purge.map_id, purge.drive_id)
        shutil.rmtree(folder, ignore_errors=True)
        self._catalog.purges.end(purge)
        return True
