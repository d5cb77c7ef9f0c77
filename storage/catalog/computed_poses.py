"""Poses of a drive that the service computed: given ones always take their place."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from storage.catalog.models import Drive, Scan
from storage.catalog.scan_poses import ScanPoses, count_posed, row_values, write_rows


def store_computed(
    session: Session,
    drive: Drive,
    poses: ScanPoses,
    odometry: Mapping[str, Any],
) -> bool:
    """Store computed poses of scans and how they were computed; times stay.

    Args:
        session: The transaction, with the drive locked.
        drive: The drive's row.
        poses: The poses of the drive's scans, with their standard deviations; scans that came since
            have none.
        odometry: How they were computed, in plain values.

    Returns:
        False if nothing is stored: the drive lacks some of these scans by now, or has given poses.
    """
    of_drive = select(Scan.index).where(Scan.drive_id == drive.id)
    if not set(poses.scans.tolist()).issubset(session.scalars(of_drive)):
        return False
    if drive.odometry is None and count_posed(session, drive.id):
        return False
    forget_computed(session, drive)
    known = np.isfinite(poses.sigmas[:, 0])
    texts = [
        json.dumps(row) if is_known else None
        for row, is_known in zip(poses.sigmas.tolist(), known.tolist(), strict=True)
    ]
    first = 0
    for rows in row_values(poses):
        of_rows = texts[first : first + len(rows)]
        write_rows(
            session,
            "UPDATE scans SET pose = ?, pose_sigma = ? WHERE drive_id = ? AND scan_index = ?",
            [(row[1], sigma, drive.id, row[0]) for row, sigma in zip(rows, of_rows, strict=True)],
        )
        first += len(rows)
    drive.odometry = dict(odometry)
    return True


def forget_computed(session: Session, drive: Drive) -> None:
    """Remove what was computed before poses are given: the check of others, and computed poses.

    Given poses are in another frame than computed ones.
    """
    drive.pose_check = None
    if drive.odometry is not None:
        session.execute(
            update(Scan).where(Scan.drive_id == drive.id).values(pose=None, pose_sigma=None)
        )
        drive.odometry = None
        session.flush()
