"""Retention: removes old revisions, returns of mapped scans, used captures and what was deleted."""

import logging
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np

from app.drives.stored_images import images_path
from app.ending import end
from app.http.logs import fields
from app.settings import Settings
from core.errors import TensorMapError
from core.mapping.tensormap import TensorMap
from storage.catalog import SERVICE_ID, Act, MapRecord, on_behalf
from storage.catalog.pages import all_items
from storage.errors import (
    CorruptImages,
    DriveNotFound,
    LostRace,
    MapNotFound,
    NotInRecycleBin,
    with_cause,
)
from storage.files.checker import Checker
from storage.files.image_file import ImageFile
from storage.files.map_file import read_map
from storage.files.stored_file import StoredFile
from storage.retention import RawScans
from storage.store import Store, StoredDrive

_EVERY_S = 3600.0  # revisions expire by age without any request
_PAUSE = 0.5  # of the time that it took to remove some captures
_LOOKS_EVERY_S = 300.0  # at the clock: what a service ran after the last look is not counted

_log = logging.getLogger("tensormap.collector")


class GarbageCollector:
    """Collects at the start, every hour, soon after a wait for the clock, and what it is woken for.

    Args:
        settings: The settings, with the retention of captures and of maps that do not set their
            own.
        store: The store with the revisions and scans.
    """

    def __init__(self, settings: Settings, store: Store) -> None:
        self._default = settings.retention
        self._deleted_kept = timedelta(days=settings.recycle_bin_days)
        self._captures_kept = timedelta(hours=settings.capture_hours)
        self._store = store
        self._wake = threading.Event()
        self._changing = threading.Lock()
        self._changed: set[str] = set()
        self._stopping = threading.Event()
        self._one = threading.Lock()
        self._thread = threading.Thread(target=self._loop, name="collector", daemon=True)

    def start(self) -> None:
        """Start the first collection."""
        self._thread.start()

    def wake(self, map_slug: str | None = None) -> None:
        """Collect now what was deleted.

        Args:
            map_slug: A map of which a revision was added or replaced, a drive closed, a job ended,
                or the retention changed: what it does not keep is collected too. To look at all
                maps takes a millisecond for each, so that is done once an hour.
        """
        if map_slug is not None:
            with self._changing:
                self._changed.add(map_slug)
        self._wake.set()

    def stop(self) -> None:
        """Stop, after the current file unless its disk hangs."""
        self._stopping.set()
        self._wake.set()
        end(self._thread)

    def collect(self, map_slugs: Collection[str] | None = None) -> bool:
        """Remove what no retention keeps; what cannot be removed is logged and stays.

        Args:
            map_slugs: Of these maps only; what was deleted is removed of all of them.

        Returns:
            Whether the clock is trusted: else nothing is removed but what is purged already and
            parts of captures that were read, as nearly all depends on an age.
        """
        with self._one:
            is_trusted = self._store.clock.is_trusted()
            if is_trusted:
                self._empty_recycle_bin()
            self._store.purges.finish_all()  # whose time was over before
            of_maps = all_items(partial(self._store.maps.list, slugs=map_slugs))
            for of_map in of_maps if is_trusted else ():
                if self._stopping.is_set():
                    break
                self._collect_of(of_map)
            # Parts of captures that were read are of no use, whatever their age.
            expired = datetime.now(UTC) - self._captures_kept if is_trusted else None
            self._clear_captures(expired)
            return is_trusted

    def _clear_captures(self, before: datetime | None) -> None:
        """Remove what is left of captures that were read, or were touched last before a time."""
        cleared = 0
        try:
            began_s = time.monotonic()
            while some := self._store.captures.clear(before):
                cleared += some
                # In this pause those write who wait for the database.
                if self._stopping.wait(_PAUSE * (time.monotonic() - began_s)):
                    break
                began_s = time.monotonic()
        except TensorMapError as error:
            _log.error(
                "captures that were read or expired cannot be removed: %s", with_cause(error)
            )
        if cleared:
            _log.info("%d captures that were read or expired were removed", cleared)

    def _loop(self) -> None:
        all_at_s = time.monotonic()
        while not self._stopping.is_set():
            changed, again_s = self._take_changed(), _EVERY_S
            is_of_all = time.monotonic() >= all_at_s
            try:
                if not self.collect(None if is_of_all else changed):
                    is_of_all, again_s = True, _LOOKS_EVERY_S
            except Exception:  # noqa: BLE001 - retention must go on after any error
                is_of_all, again_s = True, _LOOKS_EVERY_S  # which maps had changed is not known now
                _log.exception("what is not kept cannot be removed now")
            if is_of_all:
                all_at_s = time.monotonic() + again_s
            self._wake.wait(max(0.0, all_at_s - time.monotonic()))
            self._wake.clear()

    def _take_changed(self) -> Collection[str]:
        """Return the maps that changed since the last call."""
        with self._changing:
            changed, self._changed = self._changed, set()
        return changed

    def _empty_recycle_bin(self) -> None:
        """Begin to remove the maps and drives that were deleted long enough ago."""
        before = datetime.now(UTC) - self._deleted_kept
        for entry in self._store.recycle_bin.expired(before):
            if self._stopping.is_set():
                return
            subject = f"/v1/recycle-bin/{entry.id}"
            act = Act(SERVICE_ID, "purge_deleted", subject, entry.map_slug, str(entry))
            try:
                with on_behalf(act):
                    self._store.recycle_bin.begin_purge(entry.id, before=before)
            except NotInRecycleBin:
                continue  # restored or removed meanwhile, or removed with its map
            except (TensorMapError, OSError) as error:
                _log.error("%s, which was deleted, cannot be removed: %s", entry, with_cause(error))
            else:
                _log.info(
                    "%s, which was deleted, is being removed", entry, extra=fields(entry=entry.id)
                )

    def _collect_of(self, of_map: MapRecord) -> None:
        with _logged(f"what map {of_map.slug} does not keep cannot be removed", of_map):
            policy = of_map.retention.over(self._default)
            if policy.retained_revisions != "all":  # else there is nothing to ask the catalog
                for digest in self._store.revisions.collectable(of_map.id, self._default):
                    self._collect_one(of_map, digest)
            if policy.raw_scans == RawScans.DROP:
                self._drop_returns(of_map)

    def _collect_one(self, of_map: MapRecord, digest: str) -> None:
        try:
            with on_behalf(_act("collect_revision", of_map, f"revision {digest}")):
                self._store.revisions.collect(of_map.id, digest, self._default)
        except LostRace as error:
            _log.info("map %s: %s", of_map.slug, error)
        else:
            _log.info("revision collected", extra=fields(map=of_map.slug, revision=digest))

    def _drop_returns(self, of_map: MapRecord) -> None:
        """Drop the returns of the live revision's scans, if later builds do not need them."""
        if of_map.live_revision is None or self._store.catalog.collector.has_open_job(of_map.id):
            return
        live = self._store.revisions.of_map(of_map.id, of_map.live_revision)
        mapped = [
            drive
            for drive in self._store.drives.of_map(of_map.id)
            if drive.closed and live.drive_ids.get(drive.slug) == drive.id
        ]
        kept = [drive.slug for drive in self._store.drives.counted(mapped) if drive.kept_returns]
        if not kept:
            return
        tensor_map = read_map(self._store.revisions.path_of(live))
        for drive in self._store.drives.open_of_map(of_map.id, kept):
            if self._stopping.is_set():
                return
            what = f"returns of drive {drive.name} of map {of_map.slug} cannot be dropped"
            with _logged(what, of_map):
                self._drop_returns_of(of_map, drive, live.digest, tensor_map)

    def _drop_returns_of(
        self, of_map: MapRecord, drive: StoredDrive, live: str, tensor_map: TensorMap
    ) -> None:
        indices = _mapped(tensor_map, drive)
        images = images_path(self._store, drive, tensor_map.parameters)
        if not indices or not self._are_whole(images, drive, tensor_map):
            return
        detail = f"drive {drive.name}: returns of {len(indices)} scans"
        with on_behalf(_act("drop_returns", of_map, f"{detail}, mapped in {live}")):
            self._store.drives.drop_returns(live, drive, images, indices, self._default)
        _log.info(
            "returns dropped", extra=fields(map=of_map.slug, drive=drive.name, scans=len(indices))
        )

    @staticmethod
    def _are_whole(path: Path, drive: StoredDrive, tensor_map: TensorMap) -> bool:
        """Return whether the images of a drive are kept for builds.

        They are read to their end: the returns are what they can be made of again.
        """
        try:
            with ImageFile(path, tensor_map.parameters.imager) as images:
                if images.probes is None:
                    return False
            with Checker() as checker:
                fault = checker.fault(path, StoredFile(str(path)))
        except FileNotFoundError:
            return False
        except CorruptImages as error:
            what = str(error)
        else:
            if fault is None:
                return True
            what = f"{path.name} cannot be read: {fault.what}"
        _log.warning(
            "%s; the returns of drive %s are kept, a build that uses no earlier revision projects"
            " them again",
            what,
            drive.name,
        )
        return False


@contextmanager
def _logged(what: str, of_map: MapRecord) -> Iterator[None]:
    """Log the error of the block, so that others are collected; it is tried again later."""
    try:
        yield
    except MapNotFound:
        pass  # deleted with all its contents
    except DriveNotFound as error:
        _log.info("map %s: a drive was deleted meanwhile: %s", of_map.slug, error)
    except LostRace as error:
        _log.info("map %s: %s", of_map.slug, error)
    except (TensorMapError, OSError) as error:
        _log.error("%s: %s", what, with_cause(error))


def _mapped(tensor_map: TensorMap, drive: StoredDrive) -> frozenset[int]:
    """Return the indices of the drive's scans that are in the map and have their returns.

    Where several become one, all of them are.
    """
    trajectory = tensor_map.trajectory
    named = np.isin(drive.scan_index, trajectory.scan_index[trajectory.rows_of(drive.name)])
    becomes = np.arange(len(drive)) // drive.accumulate
    mapped = np.isin(becomes, becomes[named])
    return frozenset(drive.scan_index[mapped & drive.has_returns].tolist())


def _act(action: str, of_map: MapRecord, detail: str) -> Act:
    return Act(SERVICE_ID, action, f"/v1/maps/{of_map.slug}", of_map.slug, detail)
