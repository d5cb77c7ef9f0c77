"""Poses and times of scans that are still to come: kept until the scan is there."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from sqlalchemy import delete, insert, select
from sqlalchemy.orm import Session

from core.pose import Pose
from storage.catalog.models import ExpectedPose
from storage.catalog.records import ScanRecord
from storage.errors import PosesDoNotFit

__all__ = ["expect", "met", "require_fit"]


def expect(
    session: Session,
    drive_id: str,
    wanted: Mapping[int, tuple[list[float] | None, float | None]],
) -> None:
    """Keep pose and time of scans by index; what was expected of them before is forgotten."""
    _forget(session, drive_id, _expected(session, drive_id, wanted))
    rows = [
        {"drive_id": drive_id, "index": index, "pose": pose, "timestamp_s": timestamp_s}
        for index, (pose, timestamp_s) in wanted.items()
        if pose is not None or timestamp_s is not None
    ]
    if rows:
        session.execute(insert(ExpectedPose), rows)


def require_fit(
    drive_slug: str,
    poses: Mapping[int, Pose | None],
    stored: Mapping[int, ScanRecord],
    last_index: int | None,
    *,
    consecutive: bool,
) -> None:
    """Refuse a file of poses that cannot be those of a drive's scans.

    Args:
        drive_slug: The drive.
        poses: By scan index, at least one.
        stored: The scans that are there, of those of the poses.
        last_index: Of the drive's scans, `None` without one.
        consecutive: Whether lines count scans, so that a wrong number shows another drive's file.

    Raises:
        PosesDoNotFit: If poses that are stored would be forgotten; or lines count scans, and there
            are too few for the drive, or too many, and they would replace other poses.
    """
    insist = "; partial=true sets them all the same"
    if last_index is not None and consecutive:
        first, last = min(poses), max(poses)
        counted = f"the file has {len(poses)} lines, of scans {first} to {last}"
        if last < last_index:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index}{insist}"
            )
        replaced = [i for i, scan in stored.items() if scan.pose not in {None, poses.get(i)}]
        if last > last_index and replaced:
            raise PosesDoNotFit(
                f"{counted}, drive {drive_slug!r} has scans up to {last_index} and other poses of"
                f" {len(replaced)} of them{insist}"
            )
    forgotten = _forgotten(poses, stored)
    if forgotten:
        raise PosesDoNotFit(
            f"the file has no pose of scan {min(forgotten)} of drive {drive_slug!r}, which has one"
            f" ({len(forgotten)} scans would lose theirs){insist}"
        )


def _forgotten(poses: Mapping[int, Pose | None], stored: Mapping[int, ScanRecord]) -> list[int]:
    return [
        index
        for index, scan in stored.items()
        if index in poses and poses[index] is None and scan.pose is not None
    ]


def met(session: Session, drive_id: str, records: Sequence[ScanRecord]) -> list[ScanRecord]:
    """Return new scans with what was expected of them where they do not say it; forget that."""
    expected = _expected(session, drive_id, {record.index for record in records})
    _forget(session, drive_id, expected)
    return [_completed(record, expected.get(record.index)) for record in records]


def _completed(record: ScanRecord, expected: ExpectedPose | None) -> ScanRecord:
    if expected is None:
        return record
    if record.pose is None and expected.pose is not None:
        record = replace(record, pose=Pose(*expected.pose))
    if math.isnan(record.timestamp_s) and expected.timestamp_s is not None:
        record = replace(record, timestamp_s=expected.timestamp_s)
    return record


def _expected(session: Session, drive_id: str, indices: Collection[int]) -> dict[int, ExpectedPose]:
    """Return what is expected of these scans."""
    if not indices:
        return {}
    # A span, not IN (...): a database takes only so many parameters.
    query = select(ExpectedPose).where(
        ExpectedPose.drive_id == drive_id,
        ExpectedPose.index.between(min(indices), max(indices)),
    )
    wanted = set(indices)
    return {row.index: row for row in session.scalars(query) if row.index in wanted}


def _forget(session: Session, drive_id: str, indices: Collection[int]) -> None:
    for first, last in _spans(indices):
        session.execute(
            delete(ExpectedPose)
            .where(ExpectedPose.drive_id == drive_id, ExpectedPose.index.between(first, last))
            .execution_options(synchronize_session=False)
        )


def _spans(indices: Collection[int]) -> list[tuple[int, int]]:
    """Return the spans that indices make.

    Examples:
        >>> _spans({3, 1, 2, 7})
        [(1, 3), (7, 7)]
    """
    spans: list[tuple[int, int]] = []
    for index in sorted(indices):
        if spans and spans[-1][1] == index - 1:
            spans[-1] = spans[-1][0], index
        else:
            spans.append((index, index))
    return spans
