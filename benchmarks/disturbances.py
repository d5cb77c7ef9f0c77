"""Recall@1 of all methods under disturbances, the mean of five seeds.

    python -m benchmarks.disturbances DRIVES [NAME ...]

DRIVES is a folder of drives in the KITTI odometry layout. Even scans are mapped, odd scans are
queries, each disturbed with five seeds; right is a matched scan within 3 m. The simulated cities
have seeds on which nothing was chosen.
"""

import sys
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from baselines.roster import default_methods, methods_named
from benchmarks.accuracy import commit, print_table
from benchmarks.timing import machine
from core.evaluation.compare import ComparisonProtocol, compare
from core.evaluation.condition import Condition
from core.evaluation.pairing import HeldOut
from core.evaluation.split import Every
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E, HDL_64E_ON_KITTI_HEIGHT_M
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

DRIVES = ("kitti00", "kit_muehlburger", "simulated-301", "simulated-302", "simulated-303")
CITY_SCANS = 300
SEEDS = 5
WITHIN_M = 3.0
CONDITIONS = (
    Condition(),
    *(
        Condition(disturb=disturb)
        for disturb in (
            "hidden:60", "hidden:120", "fov:180", "fov:120", "fov:70", "truck:1", "truck:2",
            "pitch:3", "roll:5", "height:0.5", "reach:30", "drop:0.95", "snow:0.2", "skew:15",
            "beams:16", "beams:32",
        )
    ),
    Condition(lateral_m=5.0),
    Condition(lateral_m=4.0, yaw_deg=180.0),
    *(
        Condition(yaw_deg=yaw_deg, lateral_m=2.0, disturb="beams:vlp-16+hidden:60")
        for yaw_deg in (45.0, 135.0, 225.0, 315.0)
    ),
)  # fmt: skip


def main(folder: Path, *names: str) -> None:
    """Print a table for each drive."""
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.disturbances DRIVES` at {commit()} on {machine()}.")
    for name in names or DRIVES:
        drive = _drive(folder, name)
        print(f"\n## `{name}`\n")
        found = [_recalls(drive, seed) for seed in range(SEEDS)]
        methods = list(found[0])
        mean = {method: np.mean([one[method] for one in found], axis=0) for method in methods}
        print_table(
            ["query", *methods],
            [
                [_named(condition), *(f"{mean[method][row]:.3f}" for method in methods)]
                for row, condition in enumerate(CONDITIONS)
            ],
        )


def _drive(folder: Path, name: str) -> Drive:
    if name.startswith("simulated-"):
        return SimulatedDrive(seed=int(name.removeprefix("simulated-")), scans=CITY_SCANS)
    return open_drive(folder / name, min_returns=100)


def _recalls(drive: Drive, seed: int) -> dict[str, list[float]]:
    """Return recall@1 by method, one figure a condition."""
    methods = methods_named(
        default_methods(),
        sensor=HDL_64E.name,
        sensor_height_m=HDL_64E_ON_KITTI_HEIGHT_M,
        segment_length=len(drive),
    )
    protocol = ComparisonProtocol(
        pairing=HeldOut(Every(2), len(drive)),
        conditions=CONDITIONS,
        tolerances_m=(WITHIN_M,),
        seed=seed,
    )
    result = compare(drive, methods, protocol)
    return {
        method.name: [float(row.recall_at_1[WITHIN_M] or 0.0) for row in method.conditions]
        for method in result.methods
    }


def _named(condition: Condition) -> str:
    parts = [condition.disturb] if condition.disturb else []
    if condition.lateral_m:
        parts.append(f"{condition.lateral_m:g} m left")
    if condition.yaw_deg:
        parts.append(f"yaw {condition.yaw_deg:g}")
    return " + ".join(parts) or "undisturbed"


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
