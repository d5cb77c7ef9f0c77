"""Poses and times of scans that are still to come: kept until the scan is there."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from core.arrays import IntArray
from core.scans.pose import Pose, is_known
from storage.catalog.models import ExpectedPose
from storage.catalog.records import ScanRecord
from storage.catalog.scan_poses import ScanPoses, at_indices, poses_put, row_values, write_rows
from storage.errors import PosesDoNotFit


def expect(session: Session, drive_id: str, wanted: ScanPoses) -> None:
    """Keep pose and time of scans by index; what was expected of them before is forgotten."""
    forget(session, drive_id, wanted.scans)
    known = is_known(wanted.poses) | np.isfinite(wanted.timestamps_s)
    for rows in row_values(wanted.only(known)):
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
    """Refuse a file of poses that cannot be those of a drive's scans.

    Args:
        drive_slug: The drive.
        poses: The file's, at least one.
        before: What is stored, of those of its scans that are.
        last_index: Of the drive's scans, `None` without one.
        consecutive: Whether lines count scans, so that a wrong number shows another drive's file.

    Raises:
        PosesDoNotFit: If poses that are stored would be forgotten; or lines count scans, and there
            are too few for the drive, or too many, and they would replace other poses.
    """
    insist = "; partial=true sets them all the same"
    after = poses.only(np.isin(poses.scans, before.scans))
    put = poses_put(before, after)
    if last_index is not None and consecutive:
        first, last = int(poses.scans[0]), int(poses.scans[-1])
        counted = f"the file has {len(poses)} lines, of scans {first} to {last}"
        if last < last_index:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index}{insist}"
            )
        others = put.replaced + put.forgotten
        if last > last_index and others:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index} and other poses of"
                f" {others} of them{insist}"
            )
    if put.forgotten:
        forgotten = is_known(before.poses) & ~is_known(after.poses)
        raise PosesDoNotFit(
            f"the file has no pose of scan {before.scans[forgotten.argmax()]} of drive"
            f" {drive_slug!r}, which has one ({put.forgotten} scans would lose theirs){insist}"
        )


def met(session: Session, drive_id: str, records: Sequence[ScanRecord]) -> list[ScanRecord]:
    """Return new scans with what was expected of them where they do not say it; forget that."""
    wanted = sorted(record.index for record in records)
    expected: dict[int, Sequence[Any]] = {}
    for clause in at_indices(ExpectedPose.index, wanted):
        query = select(ExpectedPose.index, ExpectedPose.pose, ExpectedPose.timestamp_s)
        for index, *values in session.execute(
            query.where(ExpectedPose.drive_id == drive_id, clause)
        ):
            expected[index] = values
    met_here = sorted(expected.keys() & set(wanted))
    forget(session, drive_id, np.array(met_here, dtype=np.int64))
    return [_completed(record, expected.get(record.index, (None, None))) for record in records]


def forget(session: Session, drive_id: str, indices: IntArray) -> None:
    """Remove what is expected of scans, whose indices rise."""
    spans = [(drive_id, first, last) for first, last in _spans(indices)]
    if spans:
        write_rows(
            session,
            "DELETE FROM expected_poses WHERE drive_id = ? AND scan_index BETWEEN ? AND ?",
            spans,
        )


def _completed(record: ScanRecord, expected: Sequence[Any]) -> ScanRecord:
    pose, timestamp_s = expected
    if record.pose is None and pose is not None:
        record = replace(record, pose=Pose(*pose))
    if math.isnan(record.timestamp_s) and timestamp_s is not None:
        record = replace(record, timestamp_s=timestamp_s)
    return record


def _spans(indices: IntArray) -> list[tuple[int, int]]:
    """Return the spans that rising indices make.

    Examples:
        >>> _spans(np.array([1, 2, 3, 7]))
        [(1, 3), (7, 7)]
    """
    ends = np.flatnonzero(np.diff(indices) != 1)
    firsts = indices[np.concatenate([[0], ends + 1])] if len(indices) else indices
    lasts = indices[np.concatenate([ends, [len(indices) - 1]])] if len(indices) else indices
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))
