"""Drives: raw scans in chunk files and the rows that name them."""

import threading
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from core.scans.scan import Scan
from storage.catalog import (
    Catalog,
    CountedDrive,
    DriveRecord,
    PosesPut,
    RecycledRecord,
    ScanPoses,
    ScanRecord,
    on_behalf,
)
from storage.catalog.put_target import PutTarget
from storage.errors import (
    DriveClosed,
    DriveNotFound,
    LostRace,
    PosesDoNotFit,
    ReturnsGone,
    ScanConflict,
    ScanNotFound,
    StorageBusy,
)
from storage.files.claims import remove_half_written
from storage.files.drive_chunks import BYTES_PER_RETURN, scan_digest, write_chunk
from storage.files.files import discard, discarded_on_rollback, make_folder
from storage.files.free_space import OF_SCANS
from storage.files.stored_file import Fault, StoredFile, fault_of
from storage.names import new_id
from storage.retention import Retention
from storage.store.compaction import compact, in_chunks, move_into_one
from storage.store.layout import Layout
from storage.store.purges import Purges
from storage.store.put_scans import (
    MOST_SCANS,
    PutResult,
    beyond_last,
    check_indices,
    new_record,
    refusal_of,
    require_plausible,
)
from storage.store.scan_reader import ScanReader
from storage.store.stored_drive import StoredDrive

# Each lost race is another writer's progress; so many in a row have another cause.
_ATTEMPTS = 20


class Drives:
    """The drives of each map, in the order of their slugs; methods of rows are the catalog's."""

    def __init__(self, catalog: Catalog, layout: Layout, purges: Purges) -> None:
        self._catalog = catalog
        self._layout = layout
        self._purges = purges
        self._stored_scans = 0
        self._counting = threading.Lock()
        self.get = catalog.drives.get
        self.find = catalog.drives.find
        self.list = catalog.drives.list
        self.slugs = catalog.drives.slugs
        self.put = catalog.drives.put
        self.delete = catalog.recycle_bin.put_drive
        self.of_map = catalog.drives.of_map
        self.counted = catalog.drives.counted
        self.digests = catalog.scans.digests
        self.poses = catalog.poses.get
        self.put_poses = catalog.poses.put
        self.set_computed_poses = catalog.poses.set_computed
        self.set_pose_check = catalog.poses.set_check

    @property
    def stored_scans(self) -> int:
        """The number of new scans stored since this store was opened."""
        return self._stored_scans

    def put_scan(self, map_slug: str, drive_slug: str, index: int, scan: Scan) -> PutResult:
        """Store one scan; see `put_scans`."""
        return self.put_scans(map_slug, drive_slug, [(index, scan)])[0]

    def put_scans(
        self,
        map_slug: str,
        drive_slug: str,
        scans: Sequence[tuple[int, Scan]],
        *,
        drive_id: str | None = None,
    ) -> list[PutResult]:
        """Store scans, all or none; the first scan of a drive makes the drive.

        When it returns, their chunk file is fsynced and their rows are committed. Putting the same
        returns at the same index again is no error and changes nothing, also in a closed drive:
        poses and timestamps of stored scans are set with `put_poses`.

        Args:
            map_slug: The map.
            drive_slug: The drive.
            scans: Index and scan of each.
            drive_id: Id of the drive that must have that name, `None` for any or none.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If the drive with `drive_id` was deleted.
            InvalidSlug: If the drive is new, and its name is no slug.
            InvalidParameters: If an index is negative, too large for a new scan or given twice.
            ScanConflict: If other content is stored at an index; the message has both digests.
            DriveClosed: If one of the scans is new and the drive is closed.
            StorageFull: If no space is left; nothing is changed.
            StorageBusy: If others change the drive in each attempt; nothing is changed.
        """
        check_indices([index for index, _ in scans])
        by_index = {index: (scan, scan_digest(scan.points_m)) for index, scan in scans}
        for _ in range(_ATTEMPTS):
            target = self._catalog.scans.target(map_slug, drive_slug, by_index)
            _require_same(target, map_slug, drive_id)
            refusals = [refusal_of(target, i, digest) for i, (_, digest) in by_index.items()]
            if refused := [refusal for refusal in refusals if refusal is not None]:
                raise min(refused, key=lambda refusal: isinstance(refusal, DriveClosed))
            fresh = [(index, scan) for index, scan in scans if index not in target.stored]
            require_plausible(fresh)
            name = f"{new_id()}.h5"
            records = [
                new_record(name, row, index, scan, by_index[index][1])
                for row, (index, scan) in enumerate(fresh)
            ]
            try:
                self._restore_lost(target, dict(scans))
                records = self._write(target, name, fresh, records)
            except (LostRace, FileNotFoundError):  # the latter: the drive was deleted
                continue
            with self._counting:
                self._stored_scans += len(records)
            created = {record.index: record for record in records}
            return [
                PutResult(
                    index in created, created.get(index) or target.stored[index], target.drive_id
                )
                for index, _ in scans
            ]
        self._catalog.require_writable()  # it may be the whole folder that is gone
        raise StorageBusy(f"drive {drive_slug!r} changed {_ATTEMPTS} times while a scan was put")

    def refusals(
        self, map_slug: str, drive_slug: str, scans: Sequence[tuple[int, Scan]]
    ) -> list[ScanConflict | DriveClosed | None]:
        """Return why each of some scans cannot be put as the drive is now, `None` if it can.

        An index may occur several times.
        """
        target = self._catalog.scans.target(map_slug, drive_slug, {index for index, _ in scans})
        return [refusal_of(target, index, scan_digest(scan.points_m)) for index, scan in scans]

    def require_same(self, map_slug: str, drive_slug: str, drive_id: str) -> None:
        """Raise `DriveNotFound` unless a drive that got scans still has its name."""
        _require_same(self._catalog.scans.target(map_slug, drive_slug, ()), map_slug, drive_id)

    def _write(
        self,
        target: PutTarget,
        name: str,
        scans: Sequence[tuple[int, Scan]],
        records: Sequence[ScanRecord],
    ) -> list[ScanRecord]:
        """Write a chunk file, then the rows that name it; return these."""
        if not scans:
            return []
        size_bytes = BYTES_PER_RETURN * sum(len(scan) for _, scan in scans)
        OF_SCANS.require(self._layout.maps, size_bytes, "what is to be stored of the scans")
        if self._layout.has_catalog:  # its disk may be another one
            OF_SCANS.require_kept(self._layout.data_dir, "more rows of scans")
        path = make_folder(self._layout.chunks(target.map_id, target.drive_id)) / name
        with discarded_on_rollback(path):
            write_chunk(path, scans)
            return self._catalog.scans.add(target, records)

    def _restore_lost(self, target: PutTarget, scans: Mapping[int, Scan]) -> None:
        """Store scans again that are put again and whose file is damaged or gone.

        What is acknowledged can be read, also if it was stored long ago and lost since.
        """
        folder = self._layout.chunks(target.map_id, target.drive_id)
        chunks: dict[str, dict[int, ScanRecord]] = {}
        for record in target.stored.values():
            if record.has_returns:
                chunks.setdefault(record.chunk, {})[record.row] = record
        lost: list[ScanRecord] = []
        for chunk, records in chunks.items():
            path = folder / chunk
            digests = {row: record.digest for row, record in records.items()}
            try:
                fault = fault_of(path, StoredFile(str(path), digests))
            except FileNotFoundError:
                fault = Fault("it is gone")
            if fault is not None:
                lost += [record for row, record in records.items() if row not in fault.good_rows]
        if lost:
            make_folder(folder)
            move_into_one(self._catalog, target.drive_id, folder, lost, scans.__getitem__)

    def expect_poses(
        self,
        map_slug: str,
        drive_slug: str,
        poses: ScanPoses,
        *,
        partial: bool = False,
        with_scans: bool = False,
        drive_id: str | None = None,
    ) -> PosesPut:
        """Set poses, and timestamps, of stored scans and of those to come: all or none.

        A scan that is put with a pose or time later keeps its own. The drive is made if it is new.

        Args:
            map_slug: The map.
            drive_slug: The drive.
            poses: The poses of all its scans, at least one: their last one shows whether they are
                this drive's. An unknown time is left as it is.
            partial: Set them whatever their number; those of scans that a closed drive lacks are
                left over.
            with_scans: Whether they came with scans of the drive: more of them may follow.
            drive_id: Id of the drive that must have that name, `None` for any or none.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If the drive with `drive_id` was deleted.
            InvalidSlug: If the drive is new, and its name is no slug.
            ScanNotFound: If the drive is closed and lacks one of the scans.
            PosesDoNotFit: If they cannot be those of the drive's scans.
            ReturnsGone: As in `put_poses`.
            StorageBusy: If others change the drive in each attempt.
        """
        beyond = beyond_last(poses)
        for _ in range(_ATTEMPTS):
            target = self._catalog.scans.target(map_slug, drive_slug, beyond)
            _require_same(target, map_slug, drive_id)
            if never := set(beyond).difference(target.stored):
                raise PosesDoNotFit(
                    f"the file has scan {min(never)}, wanted less than {MOST_SCANS}: is it a time?"
                )
            with suppress(LostRace):
                return self._catalog.poses.expect(
                    target,
                    poses,
                    partial=partial,
                    with_scans=with_scans,
                )
        raise StorageBusy(f"drive {drive_slug!r} changed {_ATTEMPTS} times while poses were put")

    def close(self, map_slug: str, drive_slug: str) -> CountedDrive:
        """Close a drive: it accepts no new scans, and its chunk files are packed into bigger ones.

        Closing a closed drive finishes an interrupted closing. Damaged scans stay in their files.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
            StorageFull: If no space is left for packing; the drive is closed nevertheless.
        """
        drive = self._catalog.drives.close(map_slug, drive_slug)
        chunks = self._layout.chunks(drive.map_id, drive.id)
        # Packed or removed by another, or dropped by the retention, since it is closed.
        with suppress(LostRace, ScanNotFound, ReturnsGone, FileNotFoundError):
            compact(self._catalog, drive.id, chunks, self._reader(drive).scan)
        return drive

    def drop_returns(
        self,
        live_revision: str,
        drive: StoredDrive,
        images: Path,
        indices: Collection[int],
        default: Retention,
    ) -> None:
        """Drop the returns of scans that the live revision was built of.

        Scans that stay in a chunk file with them move into another one first; then the rows no
        longer name the file, and then it is removed. A crash in between leaves an orphan, which
        the next start sets aside, and never a row without its file.

        Args:
            live_revision: The revision.
            drive: The drive as it was when its images were read.
            images: Its images, of which builds are made afterwards.
            indices: Indices of the scans.
            default: What the map keeps where it did not choose otherwise.

        Raises:
            MapNotFound: If the map is gone.
            LostRace: If the map or the drive changed meanwhile, the images are gone, the drive is
                open, a job may need the returns, or the map's policy keeps them; nothing is
                dropped.
            StorageFull: If no space is left for the scans that stay; nothing is dropped.
        """
        chunks = self._layout.chunks(drive.map_id, drive.id)
        records = [one for one in self._catalog.scans.of_drive(drive.id) if one.has_returns]
        dropped = {record.chunk for record in records if record.index in indices}
        staying = [one for one in records if one.chunk in dropped and one.index not in indices]
        with on_behalf(None):  # this drops nothing
            for group in in_chunks(staying):
                move_into_one(
                    self._catalog, drive.id, chunks, group, self._reader(drive.record).scan
                )
        if not images.exists():
            raise LostRace("a build removed the images meanwhile: returns will be dropped later")
        for chunk in self._catalog.collector.drop_returns(
            live_revision, drive.record, drive.scan_poses, indices, default
        ):
            discard(chunks / chunk)

    def purge(self, map_slug: str, drive_slug: str) -> RecycledRecord:
        """Remove a drive for good: nobody finds it at once, then its rows and files go.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        entry = self._catalog.recycle_bin.put_drive(map_slug, drive_slug, purging=True)
        self._purges.finish(entry)
        return entry

    def images_folder(self, drive: DriveRecord) -> Path:
        """Return the folder for what builds cache of a drive; it is removed with the drive.

        Raises:
            DriveNotFound: If the drive was deleted since its record was read.
        """
        self._catalog.drives.require(drive.id, drive.slug)
        return make_folder(self._layout.images(drive.map_id, drive.id))

    def remove_half_written_images(self, map_id: str) -> None:
        """Remove what killed builds have written of images of a map's drives."""
        for folder in self._layout.map(map_id).glob("drives/*/images"):
            remove_half_written(folder)

    def read_scan(self, map_slug: str, drive_slug: str, index: int) -> Scan:
        """Read one scan with its timestamp and pose.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
            ScanNotFound: If the drive has no such scan.
            ReturnsGone: If its returns were dropped after a build.
            CorruptFile: If the stored scan is not the one that was put.
        """
        return self._reader(self.find(map_slug, drive_slug)).scan(index)

    def open(self, map_slug: str, drive_slug: str) -> StoredDrive:
        """Return a drive with the scans that it has now, as core reads it.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
        """
        return self._open(self.find(map_slug, drive_slug))

    def open_of_map(self, map_id: str, slugs: Sequence[str] | None = None) -> Sequence[StoredDrive]:
        """Open drives of the map of that id, whatever its slug is now; all by default.

        Raises:
            MapNotFound: If the map is gone.
            DriveNotFound: If it lacks one of the drives.
        """
        return [self._open(drive) for drive in self._catalog.drives.of_map(map_id, slugs)]

    def _open(self, drive: DriveRecord) -> StoredDrive:
        records = self._catalog.scans.of_drive(drive.id)
        return StoredDrive(drive, records, self._reader(drive).scan)

    def _reader(self, drive: DriveRecord) -> ScanReader:
        return ScanReader(self._catalog, drive, self._layout.chunks(drive.map_id, drive.id))


def _require_same(target: PutTarget, map_slug: str, drive_id: str | None) -> None:
    if drive_id is not None and (target.drive_id, target.exists) != (drive_id, True):
        raise DriveNotFound(
            f"drive {target.drive_slug!r} of map {map_slug!r} was deleted while its scans were"
            " stored; those that were stored are deleted with it"
        )
