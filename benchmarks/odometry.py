"""KITTI's segment errors of odometry, with and without loop closures; prints a table.

Over segments of 100 to 800 m, as far as a drive has them: the mean translation error as a share of
the length, and the mean rotation error. Beside it the distance of the last pose from the true one,
and what odometry says of it.

    python -m benchmarks.odometry [SEED...] [DRIVE[:EVERY[:FROM[:HEIGHT_M]]]...]

Without arguments it measures three simulated worlds on whose seeds nothing was chosen, more than a
kilometre each, in which streets are driven again. Recorded drives are compared with their own
poses: every EVERY-th scan from FROM on.
"""

import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from core.arrays import FloatArray, IntArray
from core.odometry.odometry import compute_odometry
from core.scans.drive import Drive
from core.scans.pose import matrices_from_rows
from core.scans.rigid import inverse
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.formats.drives.layouts import open_drive

SEEDS = (401, 402, 403)
SCANS = 1000
LOOP_M = 900.0
HEIGHT_M = 1.73


class SomeScans:
    """Some scans of a drive, each read once while it is in memory."""

    def __init__(self, drive: Drive, rows: IntArray) -> None:
        self.name, self._drive, self._rows = drive.name, drive, rows
        self.timestamp_s, self.poses = drive.timestamp_s[rows], drive.poses[rows]
        self.scan = lru_cache(maxsize=1200)(self._read)

    def __len__(self) -> int:
        return len(self._rows)

    def _read(self, index: int) -> Scan:
        return self._drive.scan(int(self._rows[index]))


def measure(drive: Drive, sensor_height_m: float = HEIGHT_M) -> str:
    """Return a row of the table."""
    from kiss_icp.metrics import sequence_error

    with threadpool_limits(limits=1):
        found = compute_odometry(drive, sensor_height_m)
    known = np.isfinite(found.poses).all(axis=1)
    given = _from_first(drive.poses[known])
    columns = [drive.name, f"{len(drive)}", f"{found.facts['path_m']:.0f}"]
    for rows in (found.unclosed, found.poses):
        poses = _from_first(rows[known])
        share, deg_per_m = sequence_error(given, poses)
        off_m = np.linalg.norm((poses - given)[:, :3, 3], axis=1)
        columns.append(f"{share:.2f} % {100.0 * deg_per_m:.2f}")
        columns.append(f"{off_m[-1]:.2f}")
    columns.append(f"{found.sigmas[-1, 0]:.2f}")
    columns += [str(found.facts[name]) for name in ("closures", "closures_rejected", "lost")]
    return f"| {' | '.join(columns)} |"


def _from_first(rows: FloatArray) -> FloatArray:
    poses = matrices_from_rows(rows)
    return inverse(poses[0]) @ poses


def main() -> None:
    """Print the table."""
    print(
        "| drive | scans | m | odometry: %, deg in 100 m | end off, m | with closures: %, deg in"
        " 100 m | end off, m | sigma, m | closures | rejected | lost |"
    )
    print(f"|{'---|' * 11}")
    seeds = [int(word) for word in sys.argv[1:] if word.isdigit()]
    for name in (word for word in sys.argv[1:] if not word.isdigit()):
        path, *numbers = name.split(":")
        every, first, height_m = (*map(float, numbers), *(1.0, 0.0, HEIGHT_M)[len(numbers) :])
        drive = open_drive(Path(path), min_returns=100)
        rows = np.arange(int(first), len(drive), int(every))
        print(measure(SomeScans(drive, rows), height_m), flush=True)
    for seed in SEEDS if len(sys.argv) == 1 else seeds:
        drive = SimulatedDrive(seed, SCANS, loop_m=LOOP_M, sensor=SimulatedSensor(firings=900))
        print(measure(SomeScans(drive, np.arange(SCANS))), flush=True)


if __name__ == "__main__":
    main()
