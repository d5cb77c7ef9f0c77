"""Recall@1 of all methods under disturbances, the mean of five seeds.

    python -m benchmarks.disturbances DRIVES [--drives NAME,NAME] [--methods NAME,NAME] [--seeds 5]

DRIVES is a folder of drives in the KITTI odometry layout. Even scans are mapped, odd scans are
queries, each disturbed with every seed; right is a matched scan within 3 m. The simulated cities
have seeds on which nothing was chosen. `harmonic 5x5` is `harmonic` with signatures of 5 x 5.
"""

import argparse
from collections.abc import Sequence
from functools import partial
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
WITHIN_M = 3.0
_SMALL = "harmonic 5x5"
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
    Condition(noise_m=0.5),
    Condition(noise_m=1.0),
    Condition(lateral_m=5.0),
    Condition(lateral_m=4.0, yaw_deg=180.0),
    *(
        Condition(yaw_deg=yaw_deg, lateral_m=2.0, disturb="beams:vlp-16+hidden:60")
        for yaw_deg in (45.0, 135.0, 225.0, 315.0)
    ),
)  # fmt: skip


def main() -> None:
    """Print a table for each drive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drives", default=",".join(DRIVES))
    parser.add_argument("--methods", default=",".join([*default_methods(), _SMALL]))
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.disturbances DRIVES` at {commit()} on {machine()}.")
    print(f"Means of {given.seeds} seeds.")
    for name in given.drives.split(","):
        drive = _drive(given.folder, name)
        print(f"\n## `{name}`\n", flush=True)
        found = [_recalls(drive, given.methods.split(","), seed) for seed in range(given.seeds)]
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


def _recalls(drive: Drive, names: Sequence[str], seed: int) -> dict[str, list[float]]:
    """Return recall@1 by method, one figure a condition."""
    of_sensor = partial(
        methods_named,
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
    found: dict[str, list[float]] = {}
    for chosen in ([name for name in names if name != _SMALL], [_SMALL] * (_SMALL in names)):
        if not chosen:
            continue
        small = chosen == [_SMALL]
        methods = of_sensor(["harmonic"], ranks=(5, 5)) if small else of_sensor(chosen)
        for method in compare(drive, methods, protocol).methods:
            name = _SMALL if small else method.name
            found[name] = [float(row.recall_at_1[WITHIN_M] or 0.0) for row in method.conditions]
    return found


def _named(condition: Condition) -> str:
    parts = [condition.disturb] if condition.disturb else []
    if condition.lateral_m:
        parts.append(f"{condition.lateral_m:g} m left")
    if condition.noise_m:
        parts.append(f"noise {condition.noise_m:g} m")
    if condition.yaw_deg:
        parts.append(f"yaw {condition.yaw_deg:g}")
    return " + ".join(parts) or "undisturbed"


if __name__ == "__main__":
    main()
