"""Unequal and equal segments at equal storage: tables of docs/reference/mapping-measurements.md.

    python -m benchmarks.segments DRIVES [NAME ...]

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00` and
`kit_muehlburger`. The simulated cities have seeds on which nothing was chosen. For every drive the
unequal segments of a k come first; the equal ones are as many, so that both maps hold the same
number of elements. Even scans are mapped, odd ones queried.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, print_table
from benchmarks.drives import in_memory
from benchmarks.timing import machine
from core.encodings.registry import encoding_names
from core.evaluation.evaluate import Evaluation, EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.parameters import MapParameters, Segmentation
from core.scans.drive import Drive
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

RECORDED = ("kitti00", "kit_muehlburger")
DRIVES = (*RECORDED, "simulated-101", "simulated-102", "simulated-103")
SEGMENTS = (5, 10)  # k = ceil(K / L); unequal segments are about as many
CITY_SCANS = 300


def main(folder: Path, *names: str) -> None:
    """Print the tables, of some drives or all of them."""
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.segments DRIVES` at commit {commit()} on {machine()}.")
    drives = [in_memory(_drive(folder, name)) for name in names or DRIVES]
    for encoding in encoding_names():
        print(f"\n## `{encoding}`\n")
        counts = SEGMENTS if encoding == "paper" else SEGMENTS[:1]
        rows = [_compared(drive, encoding, count) for drive in drives for count in counts]
        print_table(
            [
                "drive", "k", "L", "elements", "segment accuracy: equal", "unequal",
                "recall@1 3 m: equal", "unequal", "relative error, mean: equal", "unequal",
                "worst: equal", "unequal",
            ],
            rows,
        )  # fmt: skip


def _drive(folder: Path, name: str) -> Drive:
    if name in RECORDED:
        return open_drive(folder / name, min_returns=100)
    return SimulatedDrive(seed=int(name.removeprefix("simulated-")), scans=CITY_SCANS)


def _compared(drive: Drive, encoding: str, segments: int) -> list[str]:
    split = Every(2)  # the same scans whatever the cuts
    parameters = MapParameters.for_sensor(encoding=encoding, segmentation=Segmentation.UNEQUAL)
    unequal = evaluate(drive, EvaluationProtocol(parameters, segments=segments, split=split))
    fixed = replace(parameters, segmentation=Segmentation.FIXED)
    equal = evaluate(drive, EvaluationProtocol(fixed, segments=unequal.segments, split=split))
    if equal.compression.elements != unequal.compression.elements:
        raise RuntimeError(f"{drive.name}: {equal.segments} and {unequal.segments} segments")
    both = (equal, unequal)
    return [
        f"`{drive.name}`",
        str(-(-len(drive) // segments)),
        str(unequal.segments),
        str(unequal.compression.elements),
        *(f"{_accuracy(found):.3f}" for found in both),
        *(f"{found.conditions[0].recall_at_1[3.0]:.3f}" for found in both),
        *(f"{np.mean(found.relative_error):.3f}" for found in both),
        *(f"{max(found.relative_error):.3f}" for found in both),
    ]


def _accuracy(found: Evaluation) -> float:
    accuracy = found.conditions[0].segment_accuracy
    return float("nan") if accuracy is None else accuracy


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
