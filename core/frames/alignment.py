"""Brings the drives of a map into one frame: robust fits to their matches."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from core.frames.agreement import (
    ALONG_M,
    FrameCheck,
    as_claimed,
    explained,
    known_rows,
    require_one_frame,
    rows_to_match,
    share_places,
    unexplained,
)
from core.frames.fit import agreeing, fit_frame
from core.frames.matches import clear_matches, verified
from core.mapping.placement import Placement, beside, composed, placed
from core.mapping.tensormap import TensorMap
from core.progress import NO_PROGRESS, Progress
from core.scans.rigid import rotation_deg
from core.topology import join_segments

_SAME_M, _SAME_DEG = 1.0, 1.0  # poses that have a frame are not moved by less
_ASIDE_M = 1000.0  # between drives that do not meet: more than any map's errors


@dataclass(frozen=True, eq=False)
class Alignment:
    """Drives in one frame.

    Attributes:
        placements: The placements of those whose poses are transformed, by name.
        notes: Notes for the user, on each drive that was moved or could not be.
        apart: Names of the drives that meet none of the others.
    """

    placements: dict[str, Placement]
    notes: tuple[str, ...]
    apart: tuple[str, ...] = ()


def align_drives(
    tensor_map: TensorMap,
    movable: Collection[str],
    frameless: Collection[str],
    progress: Progress = NO_PROGRESS,
) -> Alignment:
    """Fit transforms that bring drives into the frame of those that are not movable.

    A drive is fitted to all drives that have their place, as soon as it meets one of them. If all
    are movable, the first one has its place; one whose poses were given before one whose poses were
    not. What meets none keeps its poses; but if these have no frame, or would lie where the others
    do, it is put beside them, a component of its own.

    Args:
        tensor_map: The map of all drives; neither its graph nor its calibration is used. Drives
            that it placed before are moved only if they no longer fit.
        movable: Names of the drives that may be moved.
        frameless: Names of those whose poses were computed from the scans, each in its own frame.
        progress: Receives every scan that is matched.

    Raises:
        FramesDisagree: If no transform explains the matches of a drive whose poses were given.
    """
    return _Aligning(tensor_map, movable, frameless, progress).run()


def aligned_map(
    tensor_map: TensorMap,
    progress: Progress = NO_PROGRESS,
    *,
    movable: Collection[str] | None = None,
    frameless: Collection[str] = (),
) -> tuple[TensorMap, tuple[str, ...]]:
    """Return a map with its drives in one frame, without a calibration, and notes on them.

    Signatures and cuts stay what they are.

    Args:
        tensor_map: The map of all drives.
        progress: Receives every scan that is matched.
        movable: Names of the drives that may be moved; all by default.
        frameless: Names of those whose poses were computed from the scans.

    Raises:
        FramesDisagree: If no transform explains the matches of a drive.
    """
    names = tensor_map.trajectory.drives if movable is None else movable
    aligned = align_drives(tensor_map, names, frameless, progress)
    transforms = {name: of.transform for name, of in aligned.placements.items()}
    trajectory = placed(tensor_map.trajectory, transforms)
    moved = replace(
        tensor_map,
        trajectory=trajectory,
        topology=join_segments(trajectory, tensor_map.model.segment_start),
        calibration=None,
        image_calibration=None,
        placements=composed(tensor_map.placements, aligned.placements),
    )
    return moved, aligned.notes


class _Aligning:
    def __init__(
        self,
        tensor_map: TensorMap,
        movable: Collection[str],
        frameless: Collection[str],
        progress: Progress,
    ) -> None:
        self._map, self._frameless, self._progress = tensor_map, frameless, progress
        names = self._names = tensor_map.trajectory.drives
        posed = np.unique(tensor_map.trajectory.drive_of_scan[tensor_map.trajectory.known]).tolist()
        posed.sort(key=lambda drive: names[drive] in frameless)  # is stable
        self._there = [drive for drive in posed if names[drive] not in movable]
        self._waiting = [drive for drive in posed if names[drive] in movable]
        self._placements: dict[str, Placement] = {}
        self._notes: list[str] = []
        self._apart: list[str] = []

    def run(self) -> Alignment:
        """Place all drives."""
        if not self._there:
            self._there, self._waiting = self._waiting[:1], self._waiting[1:]
        while self._waiting:
            checks: list[FrameCheck] = []
            for drive in self._waiting:
                check, met, placement = self._fit(drive)
                if placement is not None:
                    self._move(drive, placement)
                if met:
                    break
                checks.append(check)
            else:
                drive = self._waiting[0]
                self._leave(drive, checks[0])
            self._waiting.remove(drive)
            self._there.append(drive)
        return Alignment(self._placements, tuple(self._notes), tuple(self._apart))

    def _fit(self, drive: int) -> tuple[FrameCheck, bool, Placement | None]:
        """Return the check of a drive's poses, whether it meets others, and what moves it, if any.

        Poses without a frame are not where they say, wherever that is.
        """
        name, trajectory = self._names[drive], self._map.trajectory
        given = name not in self._frameless
        among = known_rows(trajectory, self._there)
        rows = rows_to_match(trajectory, drive)
        self._progress.start("aligning drives", len(rows))
        matches = clear_matches(self._map, rows, among, self._progress)
        agrees = as_claimed(trajectory, matches)
        check = FrameCheck(name, matches.queries, len(matches), int(agrees.sum()))
        found = explained(matches, np.arange(len(matches)))
        fit, transform, left = None, None, ~agrees
        if found is not None:
            fit = fit_frame(found, verified(self._map, matches.only(found.agrees), among))
            transform = fit.transform
            left = ~agreeing(transform, matches, 2.0 * ALONG_M)
        elif not check.met:
            left = np.ones_like(agrees)
        if given:
            evidence = unexplained(self._map, matches, left, among, transform)
            if evidence is not None:
                require_one_frame([replace(check, disagreement=evidence)])
        if fit is None:
            return check, given and check.met, None
        has_frame = given or name in self._map.placements
        turn_deg = float(rotation_deg(fit.transform.rotation))
        if has_frame and fit.shift_m <= _SAME_M and turn_deg <= _SAME_DEG:
            return check, True, None
        found_drives = np.unique(trajectory.drive_of_scan[fit.matches.found]).tolist()
        moved = replace(
            Placement.of(fit.transform),
            others=tuple(self._names[other] for other in found_drives),
            matches=len(fit.matches),
            spread_m=fit.spread_m,
            centre_m=tuple(fit.centre_m.tolist()),
            error_m=fit.error_m,
            error_deg=fit.error_deg,
        )
        return check, True, moved

    def _move(self, drive: int, placement: Placement, where: str = "") -> None:
        name = self._names[drive]
        self._placements[name] = placement
        self._notes.append(f"the poses of drive {name} were {placement}{where}")
        trajectory = placed(self._map.trajectory, {name: placement.transform})
        self._map = replace(self._map, trajectory=trajectory)

    def _leave(self, drive: int, check: FrameCheck) -> None:
        """Leave a drive that meets none where it is, or put it beside the others."""
        trajectory = self._map.trajectory
        poses = trajectory.poses[known_rows(trajectory, [drive])]
        others = trajectory.poses[known_rows(trajectory, self._there)]
        new = check.drive in self._frameless and check.drive not in self._map.placements
        recognises = self._map.parameters.encoder.yaw_invariant
        if new or (recognises and share_places(poses, others)):
            placement = Placement.of(beside(poses, others, _ASIDE_M))
            self._move(drive, placement, ", beside the drives that it does not meet")
        self._notes.append(f"{check}: it is a component of its own")
        self._apart.append(check.drive)
