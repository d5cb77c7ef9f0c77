"""Recall@1 of all methods under disturbances, the mean of five seeds.

    python -m benchmarks.disturbances DRIVES [--drives NAME,...] [--methods NAME,...] [--queries N]

DRIVES is a folder of drives in the KITTI odometry layout. Even scans are mapped, odd scans are
queries; of `nclt_turn` queries are those that come back to a place of 30 s before and earlier. Of
each drive at most so many are queried, evenly spread, each with every seed; conditions without
random numbers are the same for all seeds and run once. Right is a matched scan within 3 m. The
simulated cities have seeds on which nothing was chosen. `harmonic 5x5` is `harmonic` with
signatures of 5 x 5. It returns 1 if a bar of `kitti00` is missed: those of signatures, and of scans
the same and Scan Context's figure less 0.01.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from baselines.roster import BY_SCAN, METHODS, methods_named
from benchmarks.accuracy import commit, print_table
from benchmarks.maps import Once
from benchmarks.timing import machine
from core.arrays import FloatArray, IntArray
from core.evaluation.compare import ComparisonProtocol, compare
from core.evaluation.condition import Condition
from core.evaluation.disturbances import Recording
from core.evaluation.metrics import apart_m
from core.evaluation.pairing import HeldOut, LoopClosing, Paired, Pairing
from core.evaluation.split import Every
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E, HDL_64E_ON_KITTI_HEIGHT_M, sensor_named
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

DRIVES = ("kitti00", "nclt_turn", "simulated-301", "simulated-302", "simulated-303")
RECORDINGS = {"nclt_turn": Recording(sensor_named("hdl-32e"), 0.95)}
RECENT_S = {"nclt_turn": 30.0}
"""Of drives that are queried with their own loops."""
QUERIES = 60

Recalls = dict[tuple[str, Condition], float]
"""Recall@1 by method and condition."""
CITY_SCANS = 300
WITHIN_M = 3.0
_SIGNATURE, _SMALL = "harmonic", "harmonic 5x5"
_NOT_RANDOM = ("fov", "height", "reach", "skew", "beams")
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

BARS = {
    "hidden:120": 0.95, "fov:180": 0.95, "fov:120": 0.90, "fov:70": 0.80, "truck:2": 0.85,
    "pitch:3": 0.99, "roll:5": 0.99, "beams:vlp-16+hidden:60": 0.97,
}  # fmt: skip
BAR, BAR_OF_NOISE = 0.98, 0.95  # of all others, and of noise of 1 m
BARRED = "kitti00"


@dataclass(frozen=True)
class _HeldOut(HeldOut):
    """Few of the queries of `HeldOut`."""

    at_most: int = QUERIES

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        return _fewer(super().pair(drive, query_drive), drive.poses, self.at_most)


@dataclass(frozen=True)
class _Loops(LoopClosing):
    """Few of the queries of `LoopClosing`."""

    at_most: int = QUERIES

    def pair(self, drive: Drive, query_drive: Drive | None) -> Paired:
        return _fewer(super().pair(drive, query_drive), drive.poses, self.at_most)


def _fewer(paired: Paired, poses: FloatArray, at_most: int) -> Paired:
    """Return so many of the queries that have something to find, evenly spread."""
    places = poses[paired.places]
    nearest_m = [
        apart_m(places[paired.places < last], poses[query]).min(initial=np.inf)
        for query, last in zip(paired.queries, paired.first_excluded, strict=True)
    ]
    findable: IntArray = np.flatnonzero(np.array(nearest_m) <= WITHIN_M)
    chosen = findable[np.linspace(0, len(findable) - 1, min(at_most, len(findable))).astype(int)]
    return Paired(paired.places, paired.queries[chosen], paired.first_excluded[chosen])


def main() -> int:
    """Print a table for each drive; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drives", default=",".join(DRIVES))
    # map-closures is made for maps of many scans and leaves most single ones unanswered.
    parser.add_argument("--methods", default=",".join([*BY_SCAN, _SMALL, *METHODS[:-1]]))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--queries", type=int, default=QUERIES)
    given = parser.parse_args()
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.disturbances DRIVES` at {commit()} on {machine()}.")
    print(f"Means of {given.seeds} seeds.")
    missed: list[str] = []
    for name in given.drives.split(","):
        drive, pairing = _drive(given.folder, name), _pairing(name, given.queries)
        asked = len(pairing.pair(drive, None).queries)
        print(f"\n## `{name}`, {asked} queries\n", flush=True)
        recording = RECORDINGS.get(name, Recording(HDL_64E, HDL_64E_ON_KITTI_HEIGHT_M))
        names = given.methods.split(",")
        methods = _methods(names, recording, len(drive))
        found = [_recalls(drive, methods, pairing, recording, i) for i in range(given.seeds)]
        mean = {key: _mean([one[key] for one in found if key in one]) for key in found[0]}
        rows = [
            [_named(one), *(f"{mean[method, one]:.3f}" for method in names)] for one in CONDITIONS
        ]
        print_table(["query", *names], rows)
        if name == BARRED:
            missed += _missed(mean)
    for line in missed:
        print(f"missed: {line}")
    return int(bool(missed))


def _missed(mean: Recalls) -> list[str]:
    """Return the figures below their bars, in words; methods that did not take part miss none."""
    below = []
    for condition in CONDITIONS:
        bar = BAR_OF_NOISE if condition.noise_m == 1.0 else BARS.get(condition.disturb, BAR)
        of_context = mean.get(("scan-context", condition), 0.0) - 0.01
        for method, least in ((_SIGNATURE, bar), (BY_SCAN[0], max(bar, of_context))):
            recall = mean.get((method, condition), 1.0)
            if recall < least:
                below.append(f"{method}, {_named(condition)}: {recall:.3f} < {least:.3f}")
    return below


def _mean(recalls: Sequence[float]) -> float:
    return float(np.mean(recalls))


def _drive(folder: Path, name: str) -> Drive:
    if name.startswith("simulated-"):
        return SimulatedDrive(seed=int(name.removeprefix("simulated-")), scans=CITY_SCANS)
    return open_drive(folder / name, min_returns=100)


def _pairing(name: str, at_most: int) -> Pairing:
    recent_s = RECENT_S.get(name)
    if recent_s is None:
        return _HeldOut(Every(2), at_most=at_most)
    return _Loops(recent_scans=None, recent_s=recent_s, at_most=at_most)


def _is_random(condition: Condition) -> bool:
    kinds = [item.partition(":")[0] for item in condition.disturb.split("+") if item]
    return condition.noise_m > 0.0 or not set(kinds) <= set(_NOT_RANDOM)


def _methods(names: Sequence[str], recording: Recording, segment_length: int) -> list[Once]:
    of_sensor = partial(
        methods_named,
        sensor=recording.sensor.name,
        sensor_height_m=recording.height_m,
        segment_length=segment_length,
    )
    [small] = of_sensor([_SIGNATURE], ranks=(5, 5))
    return [Once(small, _SMALL) if name == _SMALL else Once(of_sensor([name])[0]) for name in names]


def _recalls(
    drive: Drive, methods: Sequence[Once], pairing: Pairing, recording: Recording, seed: int
) -> Recalls:
    """Return recall@1 by method and condition; of those that are not random only with seed 0."""
    protocol = ComparisonProtocol(
        pairing=pairing,
        conditions=tuple(one for one in CONDITIONS if seed == 0 or _is_random(one)),
        tolerances_m=(WITHIN_M,),
        seed=seed,
        recording=recording,
    )
    return {
        (method.name, row.condition): float(row.recall_at_1[WITHIN_M] or 0.0)
        for method in compare(drive, methods, protocol).methods
        for row in method.conditions
    }


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
    sys.exit(main())
