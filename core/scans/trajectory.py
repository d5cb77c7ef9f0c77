"""The drive, time and pose of each scan of a map."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray, freeze, frozen
from core.errors import EmptyDrive, InvalidMap
from core.scans.path import path_steps_m
from core.scans.pose import first_invalid, heading_deg, is_known
from core.scans.stands import stands_of
from core.text import LONGEST_NAME, flaw_in

SCAN_INDEX_LIMIT = 2**53
"""Indices are below it: every JSON parser reads them exactly."""
_FARTHEST_S = 1e300  # differences are finite; maps have times that older releases accepted
# Of a query from the scan that it matches: half a gap between scans, and a lane beside it.
_REACH_M, _LANE_M = 5.0, 3.5
_SPARSE_M = 30.0  # a longer step is one over places that the drive does not show


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The scans of a map in order, drive after drive, without their returns.

    Attributes:
        drives: Names of the D drives, all different.
        drive_start: `(D + 1,)` row of each drive's first scan, and K.
        scan_index: `(K,)` index of each scan in its own drive, rising; gaps are allowed.
        timestamp_s: `(K,)` seconds, NaN where unknown.
        poses: `(K, 7)` sensor to world, NaN where unknown.
    """

    drives: tuple[str, ...]
    drive_start: IntArray
    scan_index: IntArray
    timestamp_s: FloatArray
    poses: FloatArray

    def __post_init__(self) -> None:
        freeze(self, drive_start=np.int64, scan_index=np.int64)
        freeze(self, timestamp_s=np.float64, poses=np.float64)
        scans = len(self.scan_index)
        if scans == 0:
            raise EmptyDrive("a trajectory needs at least one scan")
        for name, *columns in (("scan_index",), ("timestamp_s",), ("poses", 7)):
            shape, wanted = getattr(self, name).shape, (scans, *columns)
            if shape != wanted:
                raise InvalidMap(f"{name} has shape {shape}, wanted {wanted}")
        # A comparison with NaN, the unknown, is false.
        if (np.abs(self.timestamp_s) > _FARTHEST_S).any():
            raise InvalidMap(f"timestamp_s has infinite numbers, or beyond {_FARTHEST_S:g} s")
        wrong = first_invalid(self.poses)
        if wrong is not None:
            raise InvalidMap(f"row {wrong} is no pose: {self.poses[wrong].tolist()}")
        for name in self.drives:
            flaw = flaw_in(name, LONGEST_NAME)
            if flaw is not None:
                raise InvalidMap(f"drives holds {ascii(name)[:80]}, wanted names: {flaw}")
        if len(set(self.drives)) < len(self.drives):
            raise InvalidMap(f"a drive is repeated in {_short(self.drives)}")
        starts = self.drive_start
        if (
            starts.shape != (len(self.drives) + 1,)
            or starts[[0, -1]].tolist() != [0, scans]
            or (np.diff(starts) < 1).any()
        ):
            raise InvalidMap(
                f"drive_start {_short(starts.tolist())} does not cut {scans} scans"
                f" into {len(self.drives)} drives"
            )
        same_drive = np.diff(self.drive_of_scan) == 0
        if self.scan_index.min() < 0 or (np.diff(self.scan_index)[same_drive] < 1).any():
            raise InvalidMap("scan_index does not rise from 0 or more in every drive")
        if self.scan_index.max() >= SCAN_INDEX_LIMIT:
            raise InvalidMap(
                f"scan_index holds {self.scan_index.max()}, wanted below {SCAN_INDEX_LIMIT}"
            )

    def __len__(self) -> int:
        return len(self.scan_index)

    def __repr__(self) -> str:  # without the arrays
        posed = int(self.known.sum())
        return f"Trajectory(scans={len(self)}, drives={_short(self.drives)}, {posed=})"

    @cached_property
    def known(self) -> BoolArray:
        """Which scans have a pose, `(K,)`."""
        return frozen(is_known(self.poses), np.bool_)

    @cached_property
    def positions_m(self) -> FloatArray:
        """x, y and z of each scan, `(3, K)`: whole columns are read faster than rows of poses."""
        return frozen(self.poses[:, :3].T.copy(), np.float64)

    @cached_property
    def headings_deg(self) -> FloatArray:
        """Heading of each scan, `(K,)`, NaN where unknown; see `heading_deg`."""
        return frozen(heading_deg(self.poses), np.float64)

    @cached_property
    def steps_m(self) -> FloatArray:
        """Way from each scan to the next row, `(K - 1,)`; see `path_steps_m`.

        NaN where a pose is unknown, and from drive to drive.
        """
        steps_m = np.full(len(self) - 1, np.nan)
        for start, end in itertools.pairwise(self.drive_start.tolist()):
            rows = start + np.flatnonzero(self.known[start:end])
            if len(rows) > 1:
                follows = np.diff(rows) == 1
                steps_m[rows[:-1][follows]] = path_steps_m(self.poses[rows, :3])[follows]
        return frozen(steps_m, np.float64)

    @cached_property
    def reach_m(self) -> FloatArray:
        """Most between each scan and a query of its place, `(K,)` metres.

        Half of the longer step to a scan with a pose before or after it in its drive, and a lane.
        """
        rows = np.flatnonzero(self.known)
        steps_m = np.linalg.norm(np.diff(self.poses[rows, :2], axis=0), axis=1)
        steps_m[np.diff(self.drive_of_scan[rows]) > 0] = 0.0
        longer_m = np.zeros(len(self))
        longer_m[rows[:-1]] = steps_m
        longer_m[rows[1:]] = np.maximum(longer_m[rows[1:]], steps_m)
        half_m = np.minimum(longer_m, _SPARSE_M) / 2.0
        return frozen(np.maximum(_REACH_M, half_m + _LANE_M), np.float64)

    @cached_property
    def stands(self) -> IntArray:
        """First and last row of the stand to which each scan belongs, `(K, 2)`; see `stands_of`."""
        spans = itertools.pairwise(self.drive_start.tolist())
        of_drives = [start + stands_of(self.poses[start:end]) for start, end in spans]
        return frozen(np.concatenate(of_drives), np.int64)

    def count_places(self, rows: BoolArray) -> int:
        """Return how many places have one of these scans, `(K,)`: each stand is one place."""
        return int(np.maximum.reduceat(rows, self.first_of_stands).sum())

    @cached_property
    def first_of_stands(self) -> IntArray:
        """First row of each stand, and each row that is in none, rising."""
        return frozen(np.unique(self.stands[:, 0]), np.int64)

    @cached_property
    def all_known(self) -> bool:
        """Whether every scan has a pose."""
        return bool(self.known.all())

    def apart_m(self, row: int) -> FloatArray:
        """Return the distance of each scan from that of a row, `(K,)`, NaN where one is unknown."""
        away_m = self.positions_m - self.positions_m[:, row, None]
        x, y, z = np.square(away_m, out=away_m)
        x += y
        x += z
        return np.asarray(np.sqrt(x, out=x))

    def path_m(self, first: int, last: int) -> float:
        """Return the length of the path from one row to another, NaN if a pose on it is unknown."""
        if not self.known[first : last + 1].all():
            return math.nan
        return float(self.steps_m[first:last].sum())

    @cached_property
    def drive_of_scan(self) -> IntArray:
        """The drive of each scan, `(K,)` indices into `drives`."""
        drives = np.arange(len(self.drives))
        return frozen(np.repeat(drives, np.diff(self.drive_start)), np.int64)

    def rows_of(self, drive: str) -> slice:
        """Return the rows of a drive, which is one of `drives`."""
        number = self.drives.index(drive)
        return slice(*self.drive_start[number : number + 2].tolist())

    def row_of(self, drive: str, scan_index: int) -> int | None:
        """Return the row of a drive's scan, `None` if it is not here."""
        if drive not in self.drives:
            return None
        rows = self.rows_of(drive)
        row = rows.start + int(np.searchsorted(self.scan_index[rows], scan_index))
        return row if row < rows.stop and self.scan_index[row] == scan_index else None

    @classmethod
    def of_drive(
        cls, name: str, timestamp_s: FloatArray, poses: FloatArray, scan_index: IntArray
    ) -> "Trajectory":
        """Return the trajectory of one drive."""
        return cls((name,), np.array([0, len(scan_index)]), scan_index, timestamp_s, poses)

    @classmethod
    def concatenate(cls, parts: Sequence["Trajectory"]) -> "Trajectory":
        """Put trajectories one after another.

        Raises:
            EmptyDrive: If there is none.
        """
        if not parts:
            raise EmptyDrive("there is no drive to map")
        offsets = np.cumsum([0] + [len(part) for part in parts])
        starts = [
            part.drive_start[:-1] + offset for part, offset in zip(parts, offsets, strict=False)
        ]
        return cls(
            tuple(name for part in parts for name in part.drives),
            np.concatenate([*starts, offsets[-1:]]),
            np.concatenate([part.scan_index for part in parts]),
            np.concatenate([part.timestamp_s for part in parts]),
            np.concatenate([part.poses for part in parts]),
        )

    def select(self, rows: IntArray) -> "Trajectory":
        """Return the trajectory of some rows, in rising order, without drives that have none."""
        drive = self.drive_of_scan[rows]
        kept, counts = np.unique(drive, return_counts=True)
        return Trajectory(
            tuple(self.drives[i] for i in kept),
            np.cumsum([0, *counts]),
            self.scan_index[rows],
            self.timestamp_s[rows],
            self.poses[rows],
        )


def _short(value: object) -> str:
    text = ascii(value)
    return text if len(text) <= 120 else f"{text[:117]}..."
