"""Poses and times of scans in the catalog: given, expected or computed."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.exc import IntegrityError

from core.scans.pose import Pose, is_known, pose_rows
from core.text import count_of
from storage.catalog import audit_chain
from storage.catalog.acts import SERVICE_ID, Act
from storage.catalog.computed_poses import store_computed
from storage.catalog.database import Repository
from storage.catalog.drives import drive_named
from storage.catalog.expected_poses import expect, forget, require_fit
from storage.catalog.models import Drive, Map, Scan
from storage.catalog.pose_changes import change_poses
from storage.catalog.put_target import PutTarget, hold
from storage.catalog.records import PosesPut
from storage.catalog.scan_poses import ScanPoses, are_all_poses, poses_from, stored_poses
from storage.errors import LostRace, ScanNotFound
from storage.names import is_recycled


class Poses(Repository):
    """The poses and times of each drive's scans."""

    def get(self, drive_id: str, first: int, limit: int) -> ScanPoses:
        """Return poses and times of the first scans of a drive from an index on."""
        with self._database.reading() as session:
            return poses_from(session, drive_id, first, limit)

    def put(
        self,
        map_slug: str,
        drive_slug: str,
        poses: Mapping[int, Pose | None],
        timestamps_s: Mapping[int, float] = MappingProxyType({}),
    ) -> PosesPut:
        """Set poses and timestamps of stored scans, also of closed drives: all or nothing.

        Raises:
            MapNotFound: If there is no such map.
            DriveNotFound: If it has no such drive.
            ScanNotFound: If one of the scans is not stored; the message names the first.
            ReturnsGone: If that needs returns which were dropped; see `change_poses`.
        """
        indices = sorted({*poses, *timestamps_s})
        scans = np.array(indices, dtype=np.int64)
        with self._database.writing(announced=False) as session:
            drive = drive_named(session, map_slug, drive_slug, lock=True)
            before = stored_poses(session, drive.id, scans)
            if len(before) < len(scans):
                missing = np.setdiff1d(scans, before.scans)
                raise ScanNotFound(
                    f"drive {drive_slug!r} has no scan {missing[0]}"
                    f" ({len(missing)} of {len(indices)} are missing)"
                )
            posed = np.array([index in poses for index in indices], dtype=bool)
            after = ScanPoses(scans, before.poses.copy(), before.timestamps_s.copy())
            after.poses[posed] = pose_rows([poses[index] for index in indices if index in poses])
            for at, index in enumerate(indices):
                after.timestamps_s[at] = timestamps_s.get(index, before.timestamps_s[at])
            any_known = any(pose is not None for pose in poses.values())
            return change_poses(session, drive, before, after, posed, any_known=any_known)

    def expect(
        self,
        target: PutTarget,
        poses: ScanPoses,
        *,
        partial: bool = False,
        with_scans: bool = False,
    ) -> PosesPut:
        """Set poses and timestamps of stored scans; keep those of scans that are not stored yet.

        Args:
            target: The drive.
            poses: The poses of all its scans, at least one; an unknown time is left as it is.
            partial: Set them even if they do not fit all scans; those of scans that a closed drive
                lacks are left over.
            with_scans: Whether they came with scans of the drive: more of them may follow.

        Raises:
            LostRace: If the target has changed.
            ScanNotFound: If the drive is closed and lacks one of the scans.
            PosesDoNotFit: If they cannot be those of the drive's scans.
            ReturnsGone: If that needs returns which were dropped; see `change_poses`.
        """
        slug, drive_id = target.drive_slug, target.drive_id
        try:
            with self._database.writing(announced=False) as session:
                hold(session, target)
                drive = session.get_one(Drive, drive_id)
                any_known = bool(is_known(poses.poses).any())
                before = stored_poses(session, drive_id, poses.scans)
                is_stored = np.isin(poses.scans, before.scans)
                missing = poses.only(~is_stored)
                if len(missing) and target.closed and not partial:
                    raise ScanNotFound(f"drive {slug!r} is closed without scan {missing.scans[0]}")
                if not partial:
                    last_index = select(func.max(Scan.index)).where(Scan.drive_id == drive_id)
                    last = session.scalar(last_index)
                    computed = drive.odometry is not None and any_known
                    require_fit(
                        slug,
                        poses,
                        before.without_poses() if computed else before,
                        last,
                        with_scans=with_scans,
                    )
                given = poses.only(is_stored)
                timed = np.isfinite(given.timestamps_s)
                timestamps_s = np.where(timed, given.timestamps_s, before.timestamps_s)
                after = ScanPoses(given.scans, given.poses, timestamps_s)
                all_of_them = np.ones(len(after), dtype=bool)
                put = change_poses(session, drive, before, after, all_of_them, any_known=any_known)
                extra = int(np.count_nonzero(is_known(missing.poses)))
                if target.closed:
                    forget(session, drive_id, missing.scans)
                    return replace(put, left_over=extra)
                expect(session, drive_id, missing)
                return replace(put, waiting=extra)
        except IntegrityError as error:  # on databases with concurrent writers
            raise LostRace(f"drive {slug!r} changed meanwhile") from error

    def set_computed(self, drive_id: str, poses: ScanPoses, odometry: Mapping[str, Any]) -> bool:
        """Set the poses of a drive's scans to computed ones: all or nothing.

        It is in the audit log as the service's.

        Args:
            drive_id: The drive.
            poses: The poses of the scans that it had, with their standard deviations.
            odometry: How they were computed, in plain values.

        Returns:
            False if nothing is set: the drive lacks some of them by now, has given poses, or is
            gone.
        """
        with self._database.writing(announced=False) as session:
            drive = session.get(Drive, drive_id, with_for_update=True)
            if drive is None or is_recycled(drive.slug):
                return False
            stored = store_computed(session, drive, poses, odometry)
            if stored:
                slug = session.get_one(Map, drive.map_id).slug
                subject = f"/v1/maps/{slug}/drives/{drive.slug}/poses"
                detail = f"poses of {count_of(len(poses), 'scan')}"
                act = Act(SERVICE_ID, "compute_poses", subject, slug, detail)
                audit_chain.append(session, act, audit_chain.DONE)
            return stored

    def set_check(self, drive_id: str, poses: ScanPoses, check: Mapping[str, Any]) -> None:
        """Store how given poses of a drive agree with its scans, unless it has others by now."""
        with self._database.writing(announced=False) as session:
            drive = session.get(Drive, drive_id, with_for_update=True)
            if drive is not None and are_all_poses(session, drive_id, poses):
                drive.pose_check = dict(check)
