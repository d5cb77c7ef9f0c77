"""The tables of docs/reference/accuracy.md, from recorded and simulated drives.

    python -m benchmarks.accuracy DRIVES > docs/reference/accuracy.md

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00` and
`kit_muehlburger`. The simulated cities have seeds on which nothing was chosen.
"""

import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from benchmarks.timing import machine
from core.evaluation.condition import Condition, conditions
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every, Interleaved
from core.parameters import MapParameters
from core.projection.reducer import RANGE_REDUCERS
from core.scans.drive import Drive
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

SEEDS = (101, 102, 103)

# As driven, turned, beside, noisy: each by itself.
DISTURBANCES: tuple[Condition, ...] = (
    *conditions((0, 10, 90, 180), (0,), (0,)),
    *conditions((0,), (1, -1, 2, -2, 3, -3), (0,)),
    *conditions((0,), (0,), (0.1, 0.5, 1.0)),
)


def main(folder: Path) -> None:
    """Print the page."""
    threadpool_limits(limits=1)
    print("# Accuracy\n")
    print("Results of the paper's encoding, 5x5; printed by\n")
    print("```text\npython -m benchmarks.accuracy DRIVES\n```\n")
    print(f"at commit {commit()} on {machine()}. `kitti00` and `kit_muehlburger` are recorded")
    print("drives of a Velodyne HDL-64E on a car; each simulated city is a drive of 300 scans.\n")
    _segments(open_drive(folder / "kit_muehlburger", min_returns=100))
    kitti00 = open_drive(folder / "kitti00", min_returns=100)
    cities = [SimulatedDrive(seed=seed) for seed in SEEDS]
    _reducers([kitti00, *cities])
    _disturbances([kitti00, *cities])


def _segments(drive: Drive) -> None:
    print("## Segments, `kit_muehlburger`\n")
    print("Consecutive scans at 10 Hz, four fifths mapped (`interleaved:0.2`, and the four other")
    print("phases of that split). Each cell: errors in total, errors while the car moves, queries.")
    print("Errors while moving occur next to a cut; which scans are held out decides whether there")
    print("are any.\n")
    phases = range(5)
    rows = []
    for length in (50, 100, 167):
        cells = []
        for phase in phases:
            split = Interleaved(0.2, phase)
            found = evaluate(
                drive, EvaluationProtocol(segment_length=length, split=split)
            ).conditions[0]
            cells.append(f"{len(found.errors)}, {found.errors_moving} of {found.queries}")
        rows.append([str(length), *cells])
    print_table(["k", *(f"phase {phase}" for phase in phases)], rows)


def _reducers(drives: Sequence[Drive]) -> None:
    print("## Reducers\n")
    print("Recall@1 within 3 m, even scans mapped, odd scans as queries, five segments.\n")
    rows = []
    for reducer in RANGE_REDUCERS:
        protocol = EvaluationProtocol(MapParameters(reducer=reducer), segments=5, split=Every(2))
        recalls = [evaluate(drive, protocol).conditions[0].recall_at_1[3.0] for drive in drives]
        rows.append([f"`{reducer}`", *(f"{recall:.3f}" for recall in recalls)])
    print_table(["reducer", *(drive.name for drive in drives)], rows)


def _disturbances(drives: Sequence[Drive]) -> None:
    print("## Relative yaw, lateral offset, noise\n")
    print("The same with `last`: the query vehicle has another yaw, is to the left of the mapped")
    print("line (the returns are moved, nothing new is seen), or has noise on every coordinate.")
    print("3 m are from where the query was recorded.\n")
    protocol = EvaluationProtocol(segments=5, split=Every(2), conditions=DISTURBANCES)
    found = [evaluate(drive, protocol).conditions for drive in drives]
    rows = []
    for index, condition in enumerate(DISTURBANCES):
        what = f"{condition.yaw_deg:g} deg, {condition.lateral_m:g} m, {condition.noise_m:g} m"
        rows.append([what, *(f"{of_it[index].recall_at_1[3.0]:.2f}" for of_it in found)])
    print_table(["yaw, lateral, noise", *(drive.name for drive in drives)], rows)


def described(condition: Condition) -> str:
    """Return what a condition changes, as in a row of a table."""
    parts = [
        f"yaw {condition.yaw_deg:g} deg" if condition.yaw_deg else "",
        f"d = {condition.lateral_m:g} m" if condition.lateral_m else "",
        f"noise {condition.noise_m:g} m" if condition.noise_m else "",
    ]
    return ", ".join(filter(None, parts)) or "as driven"


def print_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table in Markdown."""
    columns = list(head)
    print(f"| {' | '.join(columns)} |")
    print(f"|{'---|' * len(columns)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print()


def commit() -> str:
    """Name the commit that is checked out."""
    command = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
