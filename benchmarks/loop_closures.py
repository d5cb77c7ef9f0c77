"""A table of docs/reference/mapping-measurements.md: proposed closures, true and false.

    python -m benchmarks.loop_closures DRIVES [fit]

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00` and
`kit_muehlburger`. `fit` prints the
coefficients of the logistic curve in core/loop_closure/closure.py, from cities of other seeds.
Without it,
the curve is checked on cities on whose seeds nothing was chosen, and on the recorded drives; the
command fails if a bar is missed.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, print_table
from benchmarks.drives import in_memory
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.arrays import FloatArray
from core.evaluation.disturbances import KITTI_RECORDING, parse_disturbances
from core.localization.localizer import Localizer
from core.loop_closure.closure import ACCEPT_FROM, ClosureDecision, LoopClosure, check_scans
from core.parameters import MapParameters
from core.scans.drive import Drive, MemoryDrive
from core.scans.pose import heading_deg
from core.scans.scan import Scan
from core.scans.sensor import sensor_named
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.formats.drives.layouts import open_drive

FIT_SENSORS = {11: "hdl-64e", 12: "hdl-32e", 13: "vlp-16", 14: "os1-64"}
"""By the seeds of their cities."""
SENSORS = {201: "hdl-64e", 202: "hdl-32e", 203: "vlp-16"}
PASSES: tuple[tuple[float, bool], ...] = tuple(
    (offset_m, reverse) for offset_m in (0.0, 2.0, -3.0) for reverse in (False, True)
)
SCANS = 300
MAPPED_EVERY = 2
QUERY_EVERY = 25
INDEPENDENT = 256
"""Pairs that the curve is fitted as if it had: those of one street are much the same evidence."""
FIT_DISTURBANCES = (
    "",
    "hidden:120",
    "pitch:3",
    "roll:4+hidden:90",
    "drop:0.9",
    "truck:2",
    "pitch:4+drop:0.8+hidden:60",
    "reach:30",
)
"""Of which each query has one, in turn: easy closures do not show where the curve is steep."""
STATIONARY_SCANS = 190  # the first ones of kit_muehlburger
FALSE_FOR_EACH_TRUE = 3
TRUE_WITHIN_M = 5.0
FALSE_BEYOND_M = 10.0
SENSOR_HEIGHT_M = 1.73
WORST_AUROC = 0.98
WORST_PRECISION = 0.99
RECORDED = {"kitti00": 0, "kit_muehlburger": STATIONARY_SCANS}  # and the first scan that is used
DISTURBANCES = {
    "as scanned": "",
    "a third hidden": "hidden:120",
    "one return in four": "drop:0.75",
    "a third hidden, tilted by 3 degrees": "hidden:120+pitch:3",
}


@dataclass(frozen=True)
class Checked:
    """A proposed closure, what it is and what was found.

    Attributes:
        drive: Name of the city or recorded drive.
        disturbance: The disturbance of the second scan.
        is_true: Whether the scans were taken at one place.
        similarity: The similarity of their signatures, one minus the normalised distance.
        closure: The result of the check.
        yaw_error_deg: The error of the relative yaw; NaN for a false closure.
        place_error_m: The error of the displacement; NaN for a false closure.
    """

    drive: str
    disturbance: str
    is_true: bool
    similarity: float
    closure: LoopClosure
    yaw_error_deg: float
    place_error_m: float


def main(folder: Path, part: str = "") -> int:
    """Print the tables; return 1 if a bar is missed."""
    threadpool_limits(limits=1)
    print(
        f"Printed by `python -m benchmarks.loop_closures DRIVES{' ' + part if part else ''}` at"
        f" commit {commit()} on {machine()}.\n"
    )
    if part == "fit":
        _fit([j for city in FIT_SENSORS.items() for j in _city(*city, in_turn=FIT_DISTURBANCES)])
        return 0
    found = [checked for city in SENSORS.items() for checked in _city(*city)]
    for name, first in RECORDED.items():
        found += _recorded(open_drive(folder / name, min_returns=100), name, first)
    return _report(found)


def _city(seed: int, named: str, *, in_turn: Sequence[str] = ()) -> Iterator[Checked]:
    """Propose closures between a drive and second passes beside it, either way, other cars."""
    sensor = SimulatedSensor.of(sensor_named(named))
    mapped = in_memory(SimulatedDrive(seed=seed, scans=SCANS, sensor=sensor), MAPPED_EVERY)
    localizer = _localizer(mapped)
    for turn, (offset_m, reverse) in enumerate(PASSES):
        second = SimulatedDrive(
            seed=seed,
            scans=SCANS,
            lateral_offset_m=offset_m,
            reverse=reverse,
            traffic_seed=seed + 1000,
            sensor=sensor,
        )
        queried = in_memory(second, QUERY_EVERY)
        for row in range(len(queried)):
            scan = queried.scan(row)
            name = f"city {seed}, `{named}`"
            items = [in_turn[(row + turn) % len(in_turn)]] if in_turn else DISTURBANCES
            yield from _proposed(name, mapped, localizer, scan, TRUE_WITHIN_M, row, items)


def _recorded(drive: Drive, name: str, first: int) -> Iterator[Checked]:
    """Propose closures between the even scans and every tenth odd one, but the first."""
    scans = [drive.scan(row) for row in range(first, len(drive), 2)]
    mapped = MemoryDrive(drive.name, scans)
    localizer = _localizer(mapped)
    for row in range(first + 1, len(drive), 10):
        yield from _proposed(
            f"`{name}`", mapped, localizer, drive.scan(row), 3.0, row, DISTURBANCES
        )


def _proposed(
    drive: str,
    mapped: MemoryDrive,
    localizer: Localizer,
    queried: Scan,
    within_m: float,
    row: int,
    disturbances: Iterable[str],
) -> Iterator[Checked]:
    """Yield the nearest place, and the likest ones that are elsewhere, for each disturbance."""
    if queried.pose is None:
        return
    place = np.array(queried.pose.as_tuple())
    apart_m = np.linalg.norm(mapped.poses[:, :3] - place[:3], axis=1)
    nearest = int(apart_m.argmin())
    if apart_m[nearest] > within_m:
        return
    elsewhere = apart_m > FALSE_BEYOND_M
    for disturbance in disturbances:
        scan = _disturbed(queried, disturbance, np.random.default_rng([len(mapped), row]))
        signatures = localizer.basis.encode(localizer.basis.image(scan))
        search = localizer.search(signatures)
        likest = search.nearest(FALSE_FOR_EACH_TRUE, elsewhere).rows.tolist()
        candidates = (nearest, *likest)
        distances = search.distances_of(np.array(candidates)).tolist()
        for candidate, distance in zip(candidates, distances, strict=True):
            closure = check_scans(mapped.scan(candidate), scan, SENSOR_HEIGHT_M)
            errors = np.nan, np.nan
            if candidate == nearest:
                errors = _errors(mapped.poses[candidate], place, closure)
            yield Checked(
                drive,
                disturbance,
                candidate == nearest,
                1.0 - distance,
                closure,
                *errors,
            )


def _disturbed(scan: Scan, disturbance: str, rng: np.random.Generator) -> Scan:
    points_m = scan.points_m.astype(np.float64)
    for combined in parse_disturbances(DISTURBANCES.get(disturbance, disturbance)):
        for each in combined:
            points_m = each.apply(points_m, KITTI_RECORDING, rng)
    return Scan(points_m.astype(np.float32), scan.timestamp_s, scan.pose)


def _errors(first: FloatArray, second: FloatArray, closure: LoopClosure) -> tuple[float, float]:
    yaw_deg, other_deg = heading_deg(np.stack([first, second]))
    off_deg = other_deg - yaw_deg - (closure.relative_yaw_deg or 0.0)
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    x, y = second[:2] - first[:2]
    ahead_m, left_m = cos * x + sin * y, cos * y - sin * x
    off_m = np.hypot(ahead_m - (closure.forward_m or 0.0), left_m - (closure.lateral_m or 0.0))
    return float(abs((off_deg + 180.0) % 360.0 - 180.0)), float(off_m)


def _localizer(drive: MemoryDrive) -> Localizer:
    parameters = MapParameters.for_sensor(encoding="harmonic")
    return localizer_of(drive, np.arange(len(drive)), parameters)


def _evidence(checked: list[Checked]) -> FloatArray:
    return np.array(
        [[j.closure.image_similarity or 0.0, j.closure.overlap or 0.0] for j in checked]
    )


def _fit(checked: list[Checked]) -> None:
    """Fit the curve by Newton's method; true and false closures weigh the same.

    Simulated cities divide them without an error, so they do not show how steep the curve is:
    a ridge does, which weighs as much as one pair of scans of which only so many are independent.
    """
    features = _evidence(checked)
    middle, scale = features.mean(axis=0), features.std(axis=0)
    design = np.column_stack([np.ones(len(features)), (features - middle) / scale])
    truth = np.array([j.is_true for j in checked], dtype=np.float64)
    weight = np.where(truth > 0, 0.5 / truth.mean(), 0.5 / (1.0 - truth.mean()))
    ridge = np.diag([0.0, 1.0, 1.0]) * len(checked) / INDEPENDENT
    beta = np.zeros(3)
    for _ in range(50):
        odds = 1.0 / (1.0 + np.exp(-design @ beta))
        slope = design.T @ (weight * (truth - odds)) - ridge @ beta
        curvature = (design * (weight * odds * (1.0 - odds))[:, None]).T @ design + ridge
        beta += np.linalg.solve(curvature, slope)
    of = beta[1:] / scale
    print(
        f"_INTERCEPT, _OF_SIMILARITY, _OF_OVERLAP ="
        f" {beta[0] - of @ middle:.1f}, {of[0]:.1f}, {of[1]:.1f}"
        f"  # of {int(truth.sum())} true and {int((1 - truth).sum())} false closures,"
        f" seeds {', '.join(map(str, FIT_SENSORS))}"
    )


def _report(found: list[Checked]) -> int:
    missed = 0
    rows = []
    for name, of_it in _groups(found):
        truth = np.array([j.is_true for j in of_it])
        p = np.array([j.closure.probability or 0.0 for j in of_it])
        accepted = np.array([j.closure.decide() == ClosureDecision.ACCEPTED for j in of_it])
        rejected = np.array([j.closure.decide() == ClosureDecision.REJECTED for j in of_it])
        auroc = _auroc(p[truth], p[~truth])
        precision = float(truth[accepted].mean()) if accepted.any() else float("nan")
        missed += auroc < WORST_AUROC or not precision >= WORST_PRECISION
        similarity = np.array([j.similarity for j in of_it])
        evidence = _evidence(of_it)
        rows.append(
            [
                name,
                f"{int(truth.sum())} / {int((~truth).sum())}",
                f"{_auroc(similarity[truth], similarity[~truth]):.3f}",
                *(f"{_auroc(column[truth], column[~truth]):.4f}" for column in evidence.T),
                f"{auroc:.4f}",
                f"{precision:.4f}",
                f"{accepted[truth].mean():.3f}",
                f"{rejected[~truth].mean():.3f}",
                f"{np.mean((p - truth) ** 2):.4f}",
                f"{np.nanmedian([j.yaw_error_deg for j in of_it]):.2f}",
                f"{np.nanmedian([j.place_error_m for j in of_it]):.2f}",
            ]
        )
    print_table(
        [
            "second scan",
            "true / false",
            "AUROC: signature",
            "images",
            "from above",
            "**probability**",
            f"precision at {ACCEPT_FROM:g}",
            "true ones accepted",
            "false ones rejected",
            "Brier score",
            "yaw error deg",
            "place error m",
        ],
        rows,
    )
    bars = f"AUROC >= {WORST_AUROC}, precision of accepted >= {WORST_PRECISION} in every row"
    print(f"\n{bars}: {'missed ' + str(missed) + ' times' if missed else 'kept'}.")
    return 1 if missed else 0


def _groups(found: list[Checked]) -> Iterator[tuple[str, list[Checked]]]:
    for drive in dict.fromkeys(j.drive for j in found):
        for disturbance in DISTURBANCES:
            of_it = [j for j in found if (j.drive, j.disturbance) == (drive, disturbance)]
            yield f"{drive}, {disturbance}", of_it


def _auroc(of_true: FloatArray, of_false: FloatArray) -> float:
    """Return how probably a true closure scores above a false one; a draw is half of that."""
    above = (of_true[:, None] > of_false[None, :]).mean()
    return float(above + 0.5 * (of_true[:, None] == of_false[None, :]).mean())


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:]))
