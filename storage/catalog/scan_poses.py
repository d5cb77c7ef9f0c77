"""Poses and times of many scans as arrays, and their rows in the catalog."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from core.arrays import BoolArray, FloatArray, IntArray
from core.scans.pose import UNKNOWN_POSE, is_known
from storage.catalog.batches import batches
from storage.catalog.models import Scan
from storage.catalog.records import PosesPut

_ROWS_AT_ONCE = 5_000  # as Python objects
_SPARSE = 4
_UNKNOWN_SIGMAS = (math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class ScanPoses:
    """Poses and times of scans, 72 bytes for each.

    Attributes:
        scans: `(n,)` int64 indices, strictly ascending.
        poses: `(n, 7)` poses, NaN where unknown.
        timestamps_s: `(n,)` seconds, NaN where unknown.
        sigmas: `(n, 2)` standard deviations of computed poses, metres and degrees, NaN of others.
    """

    scans: IntArray
    poses: FloatArray
    timestamps_s: FloatArray
    sigmas: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self) -> None:
        if not len(self.sigmas):  # of given poses
            object.__setattr__(self, "sigmas", np.full((len(self.scans), 2), np.nan))

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.scans)

    def only(self, which: BoolArray) -> "ScanPoses":
        """Return those of the selected scans, `(n,)`."""
        return ScanPoses(
            self.scans[which], self.poses[which], self.timestamps_s[which], self.sigmas[which]
        )

    def without_poses(self) -> "ScanPoses":
        """Return the scans and their times, all poses unknown."""
        return ScanPoses(self.scans, np.full_like(self.poses, np.nan), self.timestamps_s)


def at_indices(
    column: InstrumentedAttribute[int], indices: Sequence[int]
) -> Iterator[ColumnElement[bool]]:
    """Yield conditions that together select the rows of these ascending indices.

    They may select other rows between them, but at most four for each index: the two ends of a
    drive do not select all rows in between.
    """
    if not len(indices):
        return
    first, last = indices[0], indices[-1]
    if last - first < _SPARSE * len(indices):
        yield column.between(first, last)
        return
    for some in batches(indices):
        yield column.in_(some)


def stored_poses(session: Session, drive_id: str, scans: IntArray) -> ScanPoses:
    """Return poses and times of those of these scans that are stored, in ascending order."""
    parts = [
        part
        for at in at_indices(Scan.index, scans.tolist())
        for part in _read(session, drive_id, at)
    ]
    selected = _joined(parts)
    return selected.only(np.isin(selected.scans, scans))


def poses_from(session: Session, drive_id: str, first: int, limit: int) -> ScanPoses:
    """Return poses and times of the first stored scans from an index on, in ascending order."""
    return _joined(_read(session, drive_id, Scan.index >= first, limit))


def count_posed(session: Session, drive_id: str) -> int:
    """Return how many stored scans of a drive have a pose, given or computed."""
    posed = select(func.count()).where(Scan.drive_id == drive_id, Scan.pose.is_not(None))
    return session.scalar(posed) or 0


def are_all_poses(session: Session, drive_id: str, poses: ScanPoses) -> bool:
    """Return whether the known poses of a drive are the known ones of these."""
    stored = _joined(_read(session, drive_id, Scan.pose.is_not(None)))
    return have_same_poses(stored, poses.only(is_known(poses.poses)))


def _read(
    session: Session, drive_id: str, which: ColumnElement[bool], limit: int | None = None
) -> Iterator[ScanPoses]:
    query = (
        select(Scan.index, Scan.pose, Scan.timestamp_s, Scan.pose_sigma)
        .where(Scan.drive_id == drive_id, which)
        .order_by(Scan.index)
        .limit(limit)
        .execution_options(yield_per=_ROWS_AT_ONCE)
    )
    for rows in session.execute(query).partitions():
        indices, poses, timestamps_s, sigmas = zip(*rows, strict=True)
        yield ScanPoses(
            np.array(indices, dtype=np.int64),
            np.array([pose or UNKNOWN_POSE for pose in poses], dtype=np.float64),
            np.array(timestamps_s, dtype=np.float64),  # None becomes NaN
            np.array([sigma or _UNKNOWN_SIGMAS for sigma in sigmas], dtype=np.float64),
        )


def _joined(parts: Iterable[ScanPoses]) -> ScanPoses:
    found = [ScanPoses(np.empty(0, np.int64), np.empty((0, 7)), np.empty(0)), *parts]
    return ScanPoses(
        np.concatenate([part.scans for part in found]),
        np.concatenate([part.poses for part in found]),
        np.concatenate([part.timestamps_s for part in found]),
        np.concatenate([part.sigmas for part in found]),
    )


def update_poses(session: Session, drive_id: str, before: ScanPoses, after: ScanPoses) -> None:
    """Store poses and times of stored scans, where they differ from those before."""
    changed = _differ(before.poses, after.poses).any(axis=1)
    changed |= _differ(before.timestamps_s, after.timestamps_s)
    for rows in row_values(after.only(changed)):
        write_rows(
            session,
            "UPDATE scans SET pose = ?, timestamp_s = ? WHERE drive_id = ? AND scan_index = ?",
            [(pose, timestamp_s, drive_id, index) for index, pose, timestamp_s in rows],
        )


def row_values(poses: ScanPoses) -> Iterator[list[tuple[int, str | None, float | None]]]:
    """Yield index, pose and time of each scan as values of their columns, in batches."""
    posed, timed = is_known(poses.poses), np.isfinite(poses.timestamps_s)
    numbers = np.where(posed[:, None], poses.poses, 0.0)
    for start in range(0, len(poses), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        # One JSON text of all poses takes a third of the time of a text for each.
        texts = json.dumps(numbers[part].tolist())[2:-2].split("], [")
        columns = (poses.scans, posed, poses.timestamps_s, timed)
        rows = zip(*(column[part].tolist() for column in columns), texts, strict=True)
        yield [
            (index, f"[{text}]" if with_pose else None, timestamp_s if with_time else None)
            for index, with_pose, timestamp_s, with_time, text in rows
        ]


def write_rows(session: Session, statement: str, rows: Sequence[tuple[Any, ...]]) -> None:
    """Execute a statement for each row of values of the database's own types.

    SQLAlchemy's conversion of the values of 200,000 rows takes three times as long as the rest.

    Args:
        session: The transaction.
        statement: A statement in SQL of both databases, `?` for each value.
        rows: The rows, at least one.
    """
    connection = session.connection()
    mark = {"sqlite": "?", "postgresql": "%s"}[connection.dialect.name]
    connection.exec_driver_sql(statement.replace("?", mark), list(rows))


def poses_put(before: ScanPoses, after: ScanPoses) -> PosesPut:
    """Count the changes of poses of stored scans."""
    had, has = is_known(before.poses), is_known(after.poses)
    other = _differ(before.poses, after.poses).any(axis=1)
    return PosesPut(
        set=int(np.count_nonzero(has)),
        replaced=int(np.count_nonzero(had & has & other)),
        forgotten=int(np.count_nonzero(had & ~has)),
    )


def have_same_poses(one: ScanPoses, other: ScanPoses) -> bool:
    """Return whether two have the same poses of the same scans."""
    same_scans = np.array_equal(one.scans, other.scans)
    return same_scans and not _differ(one.poses, other.poses).any()


def _differ(before: FloatArray, after: FloatArray) -> BoolArray:
    return np.asarray((before != after) & ~(np.isnan(before) & np.isnan(after)))
