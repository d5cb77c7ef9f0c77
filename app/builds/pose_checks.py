"""Given poses checked against the scans of their drive, as a part of its builds."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from app.builds.parameters import Align
from core.errors import PosesContradictScans
from core.odometry.pose_check import VERSION, Contradiction, PoseCheck, RelativeMotion, check_poses
from core.odometry.posed_drive import PosedDrive
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.mounting import stated_height_m
from core.scans.pose import UNKNOWN_POSE, PoseSource, is_known

if TYPE_CHECKING:  # a command that builds without a store does not wait for it
    from storage.store import Store, StoredDrive

_NAMED = 3  # contradictions in a note
_ADDED = {"scale", "in_map_frame", "turned_deg"}  # that checks of earlier releases lack


def check_stored(
    store: "Store",
    drives: "Sequence[StoredDrive]",
    sensor_height_m: float,
    align: Align,
    progress: Progress = NO_PROGRESS,
) -> tuple[str, ...]:
    """Check the given poses of stored drives, once for the same scans and poses; return notes.

    Args:
        store: The drives' store.
        drives: The drives.
        sensor_height_m: The map's sensor height; used where a drive has no mounting.
        align: What to do with wrong poses; with `off` they are noted only.
        progress: Receives the stages of each drive.

    Raises:
        PosesContradictScans: If a drive's poses are not those of its scans.
        CorruptFile: If a stored scan is not the one that was put.
    """
    notes: list[str] = []
    for drive in drives:
        posed = is_known(drive.poses)
        if drive.pose_source != PoseSource.GIVEN or not posed.any():
            continue
        height_m = stated_height_m(drive.mounting, sensor_height_m)
        digest = _digest(drive, height_m)
        checked = drive.pose_check if (drive.pose_check or {}).get("of") == digest else None
        readable = bool((posed & drive.has_returns).any())
        if checked is None or (readable and not checked.keys() >= _ADDED):
            if not readable:
                notes.append(
                    f"{_unknown(drive)}: their returns were dropped after a build before they were"
                )
                continue
            kept = np.where(drive.has_returns[:, None], drive.poses, UNKNOWN_POSE)
            check = check_poses(PosedDrive(drive, kept), height_m, progress)
            store.drives.set_pose_check(drive.id, drive.scan_poses, {"of": digest, **asdict(check)})
        else:
            check = _from_plain(checked)
        notes += _notes(drive, check, align)
    return tuple(notes)


def check_recorded(
    drive: Drive, sensor_height_m: float, align: Align, progress: Progress = NO_PROGRESS
) -> tuple[str, ...]:
    """Check the poses that came with a recorded drive; return notes.

    Args:
        drive: The drive as its sensor recorded it.
        sensor_height_m: Above ground.
        align: What to do with wrong poses; with `off` they are noted only.
        progress: Receives the stages.

    Raises:
        PosesContradictScans: If they are not the poses of its scans.
    """
    if not is_known(drive.poses).any():
        return ()
    return _notes(drive, check_poses(drive, sensor_height_m, progress), align)


def _notes(drive: Drive, check: PoseCheck, align: Align) -> tuple[str, ...]:
    if check.in_map_frame:
        return _refused(_frame_text(drive), align)
    if check.is_unknown:
        return (f"{_unknown(drive)}: they are too far apart, or do not show how the sensor moved",)
    slight = _slight_faults(drive, check)
    if not check.contradictions:
        return slight
    found = check.contradictions
    between = "; ".join(map(str, found[:_NAMED]))
    text = (
        f"the scans of drive {drive.name} contradict its poses, {len(found)} of"
        f" {len(found) + check.agreeing} pairs: (forward, left, up) from {between}"
    )
    if not check.is_wrong:
        return (*slight, f"{text}: is a part of the poses wrong, or late?")
    return _refused(
        f"{text}: are they another drive's, in another order, unit or system of axes? Correct"
        " them, or remove them, so that they are computed from the scans",
        align,
    )


def _refused(text: str, align: Align) -> tuple[str, ...]:
    """Return the note on wrong poses, if they are not checked.

    Raises:
        PosesContradictScans: If they are.
    """
    if align == Align.OFF:
        return (text,)
    raise PosesContradictScans(f"{text}, or do not check them (align: off)")


def _frame_text(drive: Drive) -> str:
    return (
        f"the scans of drive {drive.name} are in the frame of its poses, as clouds that SLAM has"
        " registered: their returns move along with the poses; wanted are scans in the sensor's"
        " frame, x forward, y left, z up. Upload them as they were recorded, or transform them"
        " back by their poses, as another drive"
    )


def _slight_faults(drive: Drive, check: PoseCheck) -> tuple[str, ...]:
    """Return notes on poses that agree with the scans, and are not quite those of the sensor."""
    notes = []
    if check.scale is not None:
        notes.append(
            f"the poses of drive {drive.name} say {check.scale:g} times as far as its scans: is the"
            " unit of either another one, or does odometry or a sensor measure wrongly? wanted are"
            " metres"
        )
    if check.turned_deg is not None:
        side = "left" if check.turned_deg > 0.0 else "right"
        notes.append(
            f"the poses of drive {drive.name} go {abs(check.turned_deg):.0f} degrees to the {side}"
            " of the way that its scans show: are they a vehicle's on which the sensor is turned,"
            " inverted, or in other axes? wanted are the sensor's, sensor to world"
        )
    return tuple(notes)


def _unknown(drive: Drive) -> str:
    return f"whether the poses of drive {drive.name} fit its scans could not be checked"


def _from_plain(values: Mapping[str, Any]) -> PoseCheck:
    return PoseCheck(
        values["agreeing"],
        tuple(
            Contradiction(
                fault["first"],
                fault["last"],
                RelativeMotion(**fault["by_poses"]),
                RelativeMotion(**fault["by_scans"]),
            )
            for fault in values["contradictions"]
        ),
        values["still"],
        values["unmeasured"],
        values.get("scale"),
        values.get("in_map_frame", False),
        values.get("turned_deg"),
    )


def _digest(drive: "StoredDrive", height_m: float) -> str:
    """Return the digest of all that a check depends on but the dropping of returns."""
    digest = hashlib.sha256(f"{VERSION} {height_m!r} {' '.join(drive.digests)}".encode())
    digest.update(drive.poses.astype("<f8").tobytes())
    return digest.hexdigest()
