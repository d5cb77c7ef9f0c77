"""Notes of a build on its drives: scans that it left out, poses and times that are not right."""

from collections.abc import Iterator, Sequence

from core.mapping.pipeline import Build
from core.scans.pose_steps import jumps
from core.scans.times import decreasing_rows
from storage.store import StoredDrive


def drive_notes(built: Build, drives: Sequence[StoredDrive]) -> Iterator[str]:
    """Yield notes on drives with skipped scans, times that decrease or poses too far apart."""
    trajectory = built.tensor_map.trajectory
    for drive in drives:
        left_out = built.skipped.get(drive.name)
        if left_out:
            yield (
                f"{len(left_out)} of {len(drive)} scans of drive {drive.name} are left out, first"
                f" scan {left_out[0].scan}: {left_out[0].reason}"
            )
        of_drive = trajectory.drive_of_scan == trajectory.drives.index(drive.name)
        index = trajectory.scan_index[of_drive]
        without = int((~trajectory.known[of_drive]).sum())
        if 0 < without < len(index):
            yield f"{without} of {len(index)} scans of drive {drive.name} have no pose"
        earlier = decreasing_rows(trajectory.timestamp_s[of_drive])
        if len(earlier):
            yield (
                f"the times of drive {drive.name} decrease at {len(earlier)} of {len(index)} scans,"
                f" first at scan {index[earlier[0]]}: are its scans in the order in which they were"
                " taken?"
            )
        found = jumps(index, trajectory.timestamp_s[of_drive], trajectory.poses[of_drive])
        if len(found):
            yield (
                f"the poses of drive {drive.name} jump farther than a vehicle moves at"
                f" {len(found)} of {len(index)} scans, first at scan {found[0]}: are they another"
                " drive's?"
            )
