"""Poses and times of scans that are not stored yet: kept until they are."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from core.arrays import IntArray
from core.scans.pose import Pose, is_known
from storage.catalog.models import ExpectedPose
from storage.catalog.records import ScanRecord
from storage.catalog.scan_poses import ScanPoses, at_indices, poses_put, row_values, write_rows
from storage.errors import PosesDoNotFit


def expect(session: Session, drive_id: str, poses: ScanPoses) -> None:
    """Keep pose and time of scans by index, in place of those that were kept before."""
    forget(session, drive_id, poses.scans)
    known = is_known(poses.poses) | np.isfinite(poses.timestamps_s)
    for rows in row_values(poses.only(known)):
        write_rows(
            session,
            "INSERT INTO expected_poses (drive_id, scan_index, pose, timestamp_s)"
            " VALUES (?, ?, ?, ?)",
            [(drive_id, *row) for row in rows],
        )


def require_fit(
    drive_slug: str,
    poses: ScanPoses,
    before: ScanPoses,
    last_index: int | None,
    *,
    consecutive: bool,
) -> None:
    """Reject a file of poses that cannot be those of a drive's scans.

    Args:
        drive_slug: The drive.
        poses: The file's, at least one.
        before: The stored poses of those of its scans that are stored.
        last_index: Last index of the drive's scans, `None` without one.
        consecutive: Whether lines count scans, so that a wrong number shows another drive's file.

    Raises:
        PosesDoNotFit: If stored poses would be forgotten; or lines count scans, and there are too
            few for the drive, or too many and other poses would be replaced.
    """
    advice = "; partial=true sets them nevertheless"
    after = poses.only(np.isin(poses.scans, before.scans))
    put = poses_put(before, after)
    if last_index is not None and consecutive:
        first, last = int(poses.scans[0]), int(poses.scans[-1])
        counted = f"the file has {len(poses)} lines, of scans {first} to {last}"
        if last < last_index:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index}{advice}"
            )
        others = put.replaced + put.forgotten
        if last > last_index and others:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index} and other poses of"
                f" {others} of them{advice}"
            )
    if put.forgotten:
        forgotten = is_known(before.poses) & ~is_known(after.poses)
        raise PosesDoNotFit(
            f"the file has no pose of scan {before.scans[forgotten.argmax()]} of drive"
            f" {drive_slug!r}, which has one ({put.forgotten} scans would lose theirs){advice}"
        )


def with_expected(
    session: Session, drive_id: str, records: Sequence[ScanRecord]
) -> list[ScanRecord]:
    """Return new scans, those without a pose or time with the kept one; stop keeping that."""
    indices = sorted(record.index for record in records)
    expected: dict[int, ExpectedPose] = {}
    for clause in at_indices(ExpectedPose.index, indices):
        query = select(ExpectedPose).where(ExpectedPose.drive_id == drive_id, clause)
        expected |= {row.index: row for row in session.scalars(query)}
    stored_now = sorted(expected.keys() & set(indices))
    forget(session, drive_id, np.array(stored_now, dtype=np.int64))
    return [_completed(record, expected.get(record.index)) for record in records]


def forget(session: Session, drive_id: str, indices: IntArray) -> None:
    """Remove what is kept for scans, whose indices are ascending."""
    spans = [(drive_id, first, last) for first, last in _spans(indices)]
    if spans:
        write_rows(
            session,
            "DELETE FROM expected_poses WHERE drive_id = ? AND scan_index BETWEEN ? AND ?",
            spans,
        )


def _completed(record: ScanRecord, expected: ExpectedPose | None) -> ScanRecord:
    if expected is None:
        return record
    if record.pose is None and expected.pose is not None:
        record = replace(record, pose=Pose(*expected.pose))
    if math.isnan(record.timestamp_s) and expected.timestamp_s is not None:
        record = replace(record, timestamp_s=expected.timestamp_s)
    return record


def _spans(indices: IntArray) -> list[tuple[int, int]]:
    """Return the ranges without a gap of ascending indices.

    Examples:
        >>> _spans(np.array([1, 2, 3, 7]))
        [(1, 3), (7, 7)]
    """
    runs = np.split(indices, np.flatnonzero(np.diff(indices) != 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs if len(run)]
