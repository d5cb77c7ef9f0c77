"""Changes of the poses of stored scans: given ones take the place of computed ones."""

from dataclasses import replace

import numpy as np
from sqlalchemy import update
from sqlalchemy.orm import Session

from core.arrays import BoolArray
from core.scans.pose import is_known
from storage.catalog.computed_poses import forget_computed
from storage.catalog.drives import require_returns
from storage.catalog.models import Drive, Scan
from storage.catalog.records import PosesPut
from storage.catalog.scan_poses import (
    ScanPoses,
    count_posed,
    have_same_poses,
    poses_put,
    update_poses,
)


def change_poses(
    session: Session,
    drive: Drive,
    before: ScanPoses,
    after: ScanPoses,
    given: BoolArray,
    *,
    any_known: bool,
) -> PosesPut:
    """Store new poses and times of stored scans.

    Args:
        session: The transaction, with the drive locked.
        drive: The drive's row.
        before: What is stored of these scans.
        after: What is to be stored.
        given: Which of these scans were given a pose, also an unknown one.
        any_known: Whether known poses were given, also of other scans: then no computed one stays,
            because those are in another frame.

    Raises:
        ReturnsGone: If computed poses would be lost, or a drive would change of which several scans
            become one, and the returns for others were dropped.
    """
    put = poses_put(before.only(given), after.only(given))
    if given.any():
        drive.pose_check = None
    now, computed = before, drive.odometry is not None
    if computed and any_known:
        others = count_posed(session, drive.id) - np.count_nonzero(is_known(before.poses[given]))
        put = replace(put, forgotten=put.forgotten + int(others))
        now = before.without_poses()
        after = replace(after, poses=np.where(given[:, None], after.poses, np.nan))
        forget_computed(session, drive)
    if computed and put.forgotten:
        poses = "pose" if put.forgotten == 1 else "poses"
        require_returns(
            session,
            drive,
            f"{put.forgotten} computed {poses} would be lost and cannot be computed again, put the"
            " poses of all these scans at once",
        )
    if drive.accumulate != 1 and (put.forgotten or not have_same_poses(before, after)):
        require_returns(
            session,
            drive,
            f"its images, each of {drive.accumulate} scans, cannot be made for other poses, upload"
            " it again under another name",
        )
    update_poses(session, drive.id, now, after)
    if computed and not count_posed(session, drive.id):
        forget_computed(session, drive)  # the next build computes them again
    elif computed and put.forgotten:
        without = (Scan.drive_id == drive.id) & Scan.pose.is_(None)
        session.execute(update(Scan).where(without).values(pose_sigma=None))
    return put
