"""Poses and times of scans that are not stored yet: kept until they are."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sqlalchemy import Row, bindparam, select
from sqlalchemy.orm import Session

from core.arrays import IntArray
from core.scans.pose import Pose, is_known
from core.text import count_of
from storage.catalog.models import ExpectedPose
from storage.catalog.records import ScanRecord
from storage.catalog.scan_poses import ScanPoses, at_indices, poses_put, row_values, write_rows
from storage.errors import PosesDoNotFit

_Expected = Row[int, list[float] | None, float | None]
_EXPECTED = select(ExpectedPose.index, ExpectedPose.pose, ExpectedPose.timestamp_s)
_ONE_EXPECTED = _EXPECTED.where(
    ExpectedPose.drive_id == bindparam("drive_id"), ExpectedPose.index == bindparam("scan_index")
)


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
    with_scans: bool = False,
) -> None:
    """Reject a file of poses that cannot be those of all scans of a drive.

    A last one that is another than the drive's shows another drive's file.

    Args:
        drive_slug: The drive.
        poses: The file's, at least one.
        before: The stored poses of those of its scans that are stored.
        last_index: Last index of the drive's scans, `None` without one.
        with_scans: Whether the file came with scans of the drive: more of them may follow.

    Raises:
        PosesDoNotFit: If stored poses would be forgotten, or they end before or behind the last
            scan. More are allowed if the others are those that are stored, or if the file came with
            scans and replaces no other poses.
    """
    advice = "; partial=true sets them nevertheless"
    after = poses.only(np.isin(poses.scans, before.scans))
    put = poses_put(before, after)
    if last_index is not None:
        first, last = int(poses.scans[0]), int(poses.scans[-1])
        counted = f"the file has {count_of(len(poses), 'line')}, of scans {first} to {last}"
        if last < last_index:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index}{advice}"
            )
        others = put.replaced + put.forgotten
        confirmed = is_known(before.poses).any() or not is_known(poses.poses).any()
        if last > last_index and (others or not (confirmed or with_scans)):
            having = f" and other poses of {others} of them" if others else ""
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index}{having}: another"
                " drive's? If more scans are to come, put poses before the first; if its last ones"
                " were left out, partial=true sets the others"
            )
    if put.forgotten:
        forgotten = is_known(before.poses) & ~is_known(after.poses)
        raise PosesDoNotFit(
            f"the file has no pose of scan {before.scans[forgotten.argmax()]} of drive"
            f" {drive_slug!r}, which has one"
            f" ({count_of(put.forgotten, 'scan')} would lose theirs){advice}"
        )


def with_expected(
    session: Session, drive_id: str, records: Sequence[ScanRecord]
) -> list[ScanRecord]:
    """Return new scans, those without a pose or time with the kept one; stop keeping that."""
    indices = sorted(record.index for record in records)
    connection = session.connection()
    expected: dict[int, _Expected] = {}
    if len(indices) == 1:
        one = {"drive_id": drive_id, "scan_index": indices[0]}
        expected = {row[0]: row for row in connection.execute(_ONE_EXPECTED, one)}
    else:
        for clause in at_indices(ExpectedPose.index, indices):
            query = _EXPECTED.where(ExpectedPose.drive_id == drive_id, clause)
            expected |= {row[0]: row for row in connection.execute(query)}
    stored_now = sorted(expected.keys() & set(indices))
    if stored_now:
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


def _completed(record: ScanRecord, expected: _Expected | None) -> ScanRecord:
    if expected is None:
        return record
    _, pose, timestamp_s = expected
    if record.pose is None and pose is not None:
        record = replace(record, pose=Pose(*pose))
    if math.isnan(record.timestamp_s) and timestamp_s is not None:
        record = replace(record, timestamp_s=timestamp_s)
    return record


def _spans(indices: IntArray) -> list[tuple[int, int]]:
    """Return the ranges without a gap of ascending indices.

    Examples:
        >>> _spans(np.array([1, 2, 3, 7]))
        [(1, 3), (7, 7)]
    """
    runs = np.split(indices, np.flatnonzero(np.diff(indices) != 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs if len(run)]
