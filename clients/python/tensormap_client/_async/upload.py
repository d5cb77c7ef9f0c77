"""Upload of the scans of a drive that the service does not have yet, several at a time."""

from collections import deque
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensormap_client._async.drive_requests import AsyncDriveRequests
from tensormap_client.errors import NothingUsable, OtherDrive, UnusableScan
from tensormap_client.io_async import AsyncWork, AsyncWorkers, computed
from tensormap_client.problems import DriveClosed, InvalidPose, ScanConflict, ScopeMissing
from tensormap_client.progress import Progress
from tensormap_client.sources import ScanBody, Source
from tensormap_client.uploaded import Put, StoredScans, Unusable, Uploaded

_MOST_REQUESTS = 4
# What was on its way when a client is killed is sent again: at most 1 % of the drive.
_LARGEST_SHARE = 100
# The service stores small scans faster in groups.
_GROUP_BYTES, _GROUP_SCANS = 2**20, 256
_MOST_WAITING_BYTES = 64 * 2**20
_ANOTHER = ": upload it as another drive, or delete that one"


@dataclass(frozen=True)
class AsyncSending:
    """Scans on their way in one request."""

    scans: Sequence[ScanBody]
    work: AsyncWork[Put]

    @property
    def size_bytes(self) -> int:
        """The scans' total size."""
        return sum(len(scan.body) for scan in self.scans)


async def upload_drive(
    requests: AsyncDriveRequests, source: Source, progress: Progress
) -> Uploaded:
    """Store those scans of a drive that the service lacks, with their times and poses.

    A scan that cannot be used is skipped. Repeated after an interruption, it continues: what is
    stored is not sent again.

    Args:
        requests: The requests for the drive.
        source: The drive as it was recorded.
        progress: Receives each scan.

    Raises:
        OtherDrive: If the service's drive has scans that the source does not have, or was deleted
            meanwhile.
        NothingUsable: If no scan could be stored.
        ClientError: If the service cannot be reached or rejects the upload.
        OSError: If a file cannot be read.
    """
    if not len(source):
        raise NothingUsable(f"{source.name} has no scan")
    stored = await requests.stored()
    await _require_same(requests, source, stored)
    # Sources of others may be without any.
    notes = (*getattr(source, "notes", ()), *await _kept(requests, source, stored))
    done = Uploaded(len(source), stored.count, notes=notes)
    progress.start("uploading", len(source))
    progress.move_to(stored.count)
    most_scans = max(len(source) // _LARGEST_SHARE, 1)
    at_once = min(most_scans, _MOST_REQUESTS)
    group_scans = min(most_scans // at_once, _GROUP_SCANS)
    usable = _usable(source, _missing(stored, len(source)), done, progress)
    sending: deque[AsyncSending] = deque()
    async with AsyncWorkers(at_once) as workers:
        async for group in _groups(usable, group_scans):
            sending.append(AsyncSending(group, workers.start(_put, requests, group)))
            while (
                len(sending) >= at_once
                or sum(one.size_bytes for one in sending) > _MOST_WAITING_BYTES
            ):
                await _finish(sending.popleft(), done, progress)
        while sending:
            await _finish(sending.popleft(), done, progress)
    if not done.before + done.stored:
        raise NothingUsable(
            f"none of the {len(source)} scans of {source.name} can be used; scan"
            f" {done.skipped[0].index}: {done.skipped[0].reason}",
            done.skipped,
        )
    if source.beside and (done.stored or stored.with_pose < stored.count):
        done.unused_files = await requests.put_files(source.beside)
    elif source.beside:  # they may be older than poses that were put since
        names = ", ".join(file.name for file in source.beside)
        done.notes += (
            f"{names}: not sent, as no scan is new and the stored ones have poses; to replace"
            " these, send the files to POST .../scans as a tar archive",
        )
    await _require_kept(requests, done)
    return done


async def _require_kept(requests: AsyncDriveRequests, done: Uploaded) -> None:
    """Reject a drive without the scans that were stored: later requests made it anew."""
    stored, kept = done.before + done.stored, (await requests.stored()).count
    if kept < stored:
        raise OtherDrive(
            f"drive {requests.drive_slug!r} has {_scans(kept)}, {stored} were stored: it was"
            " deleted meanwhile; upload again to store the others in the new one"
        )


async def _usable(
    source: Source, indices: Iterable[int], done: Uploaded, progress: Progress
) -> AsyncIterator[ScanBody]:
    """Yield scans as they are sent; skip those that cannot be read."""
    for index in indices:
        try:
            yield await _read(source, index)
        except UnusableScan as error:
            done.skip(index, str(error))
            progress.advance()


async def _read(source: Source, index: int) -> ScanBody:
    return await computed(lambda: source.scan_body(index))


async def _groups(
    scans: AsyncIterator[ScanBody], most_scans: int
) -> AsyncIterator[Sequence[ScanBody]]:
    """Yield scans in groups of one media type: a request each."""
    group: list[ScanBody] = []
    size_bytes = 0
    async for scan in scans:
        size_bytes += len(scan.body)
        if group and (size_bytes > _GROUP_BYTES or scan.media_type != group[0].media_type):
            yield group
            group, size_bytes = [], len(scan.body)
        group.append(scan)
        if len(group) == most_scans:
            yield group
            group, size_bytes = [], 0
    if group:
        yield group


async def _put(requests: AsyncDriveRequests, scans: Sequence[ScanBody]) -> Put:
    if len(scans) > 1:
        try:
            return await requests.put_scans(scans)
        except InvalidPose:  # of one of them, or times that fall: nothing of the group was stored
            pass
    puts = [await requests.put_scan(scan) for scan in scans]
    unusable = tuple(one for put in puts for one in put.unusable)
    return Put(sum(put.present for put in puts), unusable)


async def _finish(one: AsyncSending, done: Uploaded, progress: Progress) -> None:
    """Wait for an answer and count it."""
    put = await one.work.result()
    for scan in put.unusable:
        _require_own(scan)
        done.skip(int(scan.file), scan.reason)
    done.before += put.present  # by another upload of the drive
    done.stored += len(one.scans) - len(put.unusable) - put.present
    done.sent_bytes += one.size_bytes
    progress.sent(one.size_bytes)
    progress.advance(len(one.scans))


def _require_own(refused: Unusable) -> None:
    """Reject a drive that has another scan at an index, or takes no more."""
    if refused.problem in {ScanConflict.problem, DriveClosed.problem}:
        raise OtherDrive(f"{refused.reason}{_ANOTHER}")


def _scans(count: int) -> str:
    return f"{count} scan{'s' * (count != 1)}"


def _missing(stored: StoredScans, scans: int) -> Iterator[int]:
    """Yield the indices below `scans` that are not stored."""
    begin = 0
    for first, last in stored.ranges:
        yield from range(begin, min(first, scans))
        begin = last + 1
    yield from range(begin, scans)


async def _require_same(requests: AsyncDriveRequests, source: Source, stored: StoredScans) -> None:
    """Reject a drive whose stored scans are not those of the source, by some of them.

    Raises:
        OtherDrive: If they differ.
        UnusableScan: If one of them cannot be read in the source, as in another format than it has.
    """
    if not stored.count:
        return
    name, last = requests.drive_slug, stored.ranges[-1][1]
    if last >= len(source):
        raise OtherDrive(
            f"drive {name!r} has a scan {last}, {source.name} has {_scans(len(source))}{_ANOTHER}"
        )
    for index in stored.samples:
        scan = await _read(source, index)
        if scan.returns_m is None:
            await _require_taken(requests, scan)
            continue
        try:
            stored_m = await requests.returns_m(index)
        except ScopeMissing:  # a key that may only write
            await _require_taken(requests, scan)
            continue
        if stored_m is not None and not _equal(stored_m, scan, name):
            raise OtherDrive(
                f"scan {index} of drive {name!r} has other returns than that of"
                f" {source.name}{_ANOTHER}"
            )


async def _kept(
    requests: AsyncDriveRequests, source: Source, stored: StoredScans
) -> tuple[str, ...]:
    """Note if some of the stored scans have another pose or time in the source."""
    for index in stored.samples:
        scan = await _read(source, index)
        if scan.pose is None and scan.timestamp_s is None:
            continue
        try:
            pose, time_s = await requests.pose_and_time(index)
        except ScopeMissing:  # a key that may only write
            return ()
        if _differ(scan.pose, pose) or _differ(scan.timestamp_s, time_s):
            return (
                f"scan {index} has another pose or time in {source.name} than in drive"
                f" {requests.drive_slug!r}: stored scans keep their poses and times, and PUT"
                " .../poses changes them",
            )
    return ()


def _differ(here: ArrayLike | None, stored: ArrayLike | None) -> bool:
    """Return whether what is known here is not what is stored."""
    return here is not None and (stored is None or not np.allclose(here, stored, 0.0, 1e-6))


async def _require_taken(requests: AsyncDriveRequests, scan: ScanBody) -> None:
    """Send a stored scan again: the service compares it."""
    for refused in (await requests.put_scan(scan)).unusable:
        _require_own(refused)


def _equal(stored_m: NDArray[np.float32], scan: ScanBody, drive_slug: str) -> bool:
    """Compare a stored scan with that of the source; one that cannot be read is no other one."""
    try:
        return scan.returns_m is not None and np.array_equal(stored_m, scan.returns_m())
    except UnusableScan as error:
        raise UnusableScan(
            f"scan {scan.index} of drive {drive_slug!r} is stored, but cannot be read here to"
            f" compare the two: {error}"
        ) from error
