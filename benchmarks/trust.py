"""The tables of docs/reference/trust-measurements.md: calibration error, and unknown places.

    python -m benchmarks.trust DRIVES [harmonic|paper] [recorded|cities]

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00` and
`kit_muehlburger`. Nothing was chosen on the seeds of the cities. It returns 1 if the harmonic
encoding misses a bar in its default setting.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, print_table
from benchmarks.drives import in_memory
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.arrays import FloatArray, IntArray
from core.confidence.places import AWAY_M
from core.encodings.registry import encoding_names
from core.evaluation.reliability import Outcome, Reliability, reliability
from core.localization.localizer import Localization, Localizer
from core.parameters import MapParameters
from core.scans.drive import Drive, MemoryDrive
from core.scans.pose import Pose
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

SEEDS = (601, 602, 603)
CITY_SCANS = 300
QUERY_EVERY = 10
# Left of the line in metres, and whether against its direction.
PASSES = ((0.0, False), (1.0, True), (2.0, False), (-3.0, True), (-1.5, False), (3.0, False))
LEAST_AUROC, MOST_ECE = 0.98, 0.05


def main(folder: Path, *chosen: str) -> int:
    """Print the tables; return 1 if a bar is missed."""
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.trust DRIVES` at commit {commit()} on {machine()}.\n")
    encodings = [name for name in chosen if name in encoding_names()] or encoding_names()
    missed: list[str] = []
    for encoding in encodings:
        parameters = MapParameters.for_sensor(encoding=encoding)
        print(f"## `{encoding}`, {parameters.ranks[0]}x{parameters.ranks[1]}, {parameters.reducer}")
        rows: list[list[str]] = []
        bars: list[str] = []
        if "cities" not in chosen:
            rows.append(_recorded(folder, parameters, bars))
        if "recorded" not in chosen:
            rows += _cities(parameters, bars)
        print()
        print_table(
            [
                "positives",
                "negatives",
                "right",
                "AUROC",
                "AUROC of the right ones",
                "av. prec.",
                "ECE, both",
                "adaptive",
                "ECE, positives alone",
                "refused right / wrong / unknown",
                "within 1, 2 std along",
                "lateral",
                "heading",
            ],
            rows,
        )
        if encoding == "harmonic":
            missed = bars
    for bar in missed:
        print(f"missed: {bar}")
    return int(bool(missed))


def _recorded(folder: Path, parameters: MapParameters, bars: list[str]) -> list[str]:
    drive, other = (
        open_drive(folder / name, min_returns=100) for name in ("kitti00", "kit_muehlburger")
    )
    localizer = _localizer(drive, np.arange(0, len(drive), 2), parameters)
    queried = [_localized(localizer, drive, i) for i in range(1, len(drive), 2)]
    unknown = [localizer.localize_scan(other.scan(i)) for i in range(len(other))]
    return _row("`kitti00`, odd scans", "`kit_muehlburger`", queried, unknown, bars, city=False)


def _cities(parameters: MapParameters, bars: list[str]) -> list[list[str]]:
    passes = {seed: [_second_pass(seed, *how) for how in PASSES] for seed in SEEDS}
    firsts = {
        seed: [city.scan(i) for i in range(0, CITY_SCANS, 4)]
        for seed in SEEDS
        for city in [SimulatedDrive(seed=seed, scans=CITY_SCANS)]
    }
    rows = []
    for seed in SEEDS:
        city = SimulatedDrive(seed=seed, scans=CITY_SCANS)
        mapped = MemoryDrive(city.name, list(city))
        localizer = _localizer(mapped, np.arange(CITY_SCANS), parameters)
        promised = passes[seed] if parameters.distance is not None else passes[seed][:1]
        queried = [_localized(localizer, drive, i) for drive in promised for i in range(len(drive))]
        unknown = [
            localizer.localize_scan(drive.scan(i))
            for other in SEEDS
            if other != seed
            for drive in passes[other]
            for i in range(0, len(drive), 2)
        ]
        others = ", ".join(str(other) for other in SEEDS if other != seed)
        rows.append(_row(f"city {seed}", f"cities {others}", queried, unknown, bars, city=True))
        even = _localizer(mapped, np.arange(0, CITY_SCANS, 2), parameters)
        queried = [_localized(even, mapped, i) for i in range(1, CITY_SCANS, 2)]
        unknown = [
            even.localize_scan(scan) for other in SEEDS if other != seed for scan in firsts[other]
        ]
        # As on the recorded drive: the same pass, so the other cars are the same too.
        name = f"city {seed}, odd scans"
        rows.append(_row(name, f"cities {others}", queried, unknown, bars, city=True))
    return rows


def _second_pass(seed: int, offset_m: float, reverse: bool) -> MemoryDrive:  # noqa: FBT001
    drive = SimulatedDrive(
        seed=seed,
        scans=CITY_SCANS,
        lateral_offset_m=offset_m,
        reverse=reverse,
        traffic_seed=seed + 1000,
    )
    return in_memory(drive, QUERY_EVERY)


def _localizer(drive: Drive, rows: IntArray, parameters: MapParameters) -> Localizer:
    return localizer_of(drive, rows, parameters, segments=5, calibrated=True)


def _localized(localizer: Localizer, drive: Drive, index: int) -> tuple[Localization, FloatArray]:
    return localizer.localize_scan(drive.scan(index)), drive.poses[index]


def _row(
    positives: str,
    negatives: str,
    queried: Sequence[tuple[Localization, FloatArray]],
    unknown: Sequence[Localization],
    bars: list[str],
    *,
    city: bool,
) -> list[str]:
    right = [_is_right(found, pose) for found, pose in queried]
    known = [_outcome(f, right=is_right) for (f, _), is_right in zip(queried, right, strict=True)]
    elsewhere = [_outcome(found, right=False) for found in unknown]
    of_all = reliability(known, elsewhere)
    of_right = reliability([checked for checked in known if checked.right], elsewhere)
    bars += _missed(positives, of_all, city=city)
    within = _coverage([pair for pair, is_right in zip(queried, right, strict=True) if is_right])
    return [
        positives,
        negatives,
        f"{np.mean(right):.3f}",
        _figure(of_all.auroc),
        _figure(of_right.auroc),
        _figure(of_all.average_precision),
        _figure(of_all.ece_mixed),
        _figure(of_all.ece_mixed_adaptive),
        _figure(of_all.ece),
        " / ".join(
            map(_figure, (of_all.refused_right, of_all.refused_wrong, of_all.refused_unknown))
        ),
        *within,
    ]


def _missed(name: str, found: Reliability, *, city: bool) -> list[str]:
    missed = []
    if found.auroc is None or found.auroc < LEAST_AUROC:
        missed.append(f"{name}: AUROC {_figure(found.auroc)}, required {LEAST_AUROC}")
    if city and (found.ece_mixed is None or found.ece_mixed > MOST_ECE):
        missed.append(f"{name}: ECE {_figure(found.ece_mixed)}, required {MOST_ECE}")
    return missed


def _is_right(found: Localization, pose: FloatArray) -> bool:
    assert found.best.pose is not None  # noqa: S101 - these drives have poses
    place = np.array(found.best.pose.as_tuple())
    return bool(np.linalg.norm(place[:3] - pose[:3]) < AWAY_M)


def _outcome(found: Localization, *, right: bool) -> Outcome:
    assert found.decision.probability is not None  # noqa: S101 - these maps are calibrated
    return Outcome(found.decision.probability, found.localized, right)


def _coverage(queried: Sequence[tuple[Localization, FloatArray]]) -> list[str]:
    """Return the shares of errors within one and two standard deviations, 68 and 95 % if normal."""
    errors: list[tuple[float, float, float]] = []
    for found, row in queried:
        best, deviation = found.best, found.deviation
        place = best.pose if best.estimated_pose is None else best.estimated_pose
        if deviation is None or place is None or best.pose is None:
            continue
        x_m, y_m = place.x_m - row[0], place.y_m - row[1]
        path = np.radians(best.pose.yaw_deg)
        turn_deg = place.yaw_deg - Pose(*row.tolist()).yaw_deg
        errors.append(
            (
                (x_m * np.cos(path) + y_m * np.sin(path)) / deviation.along_m,
                (y_m * np.cos(path) - x_m * np.sin(path)) / deviation.lateral_m,
                ((turn_deg + 180.0) % 360.0 - 180.0) / deviation.heading_deg,
            )
        )
    if not errors:
        return ["-"] * 3
    one, two = ((np.abs(errors) <= sigma).mean(axis=0).tolist() for sigma in (1.0, 2.0))
    return [f"{of_one:.2f}, {of_two:.2f}" for of_one, of_two in zip(one, two, strict=True)]


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:]))
