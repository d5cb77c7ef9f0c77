"""The last tables of docs/reference/harmonic-measurements.md: what it costs to keep a basis.

    python -m benchmarks.kept_basis DRIVES

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00` and
`kit_muehlburger`. A basis is fitted to one drive alone and kept for another.
"""

import sys
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, print_table
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.arrays import Float32Array
from core.encodings.grams import drive_gram, fit_radial_basis
from core.encodings.harmonic.basis import HarmonicBasis
from core.parameters import MapParameters
from core.projection.images import project_drive
from core.scans.displacement import seen_from_beside
from core.scans.drive import Drive
from core.scans.scan import Scan
from core.scans.stands import first_of_stands
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

SEEDS = (201, 202, 203)
CITY_SCANS = 150
FITTED_TO = 30  # scans of a drive: its Gram hardly changes with more
ASIDE_M = (0.0, 3.0)
WITHIN_M = 3.0


def main(folder: Path) -> None:
    """Print the tables."""
    threadpool_limits(limits=1)
    print(
        f"Printed by `python -m benchmarks.kept_basis DRIVES` at commit {commit()} on {machine()}."
    )
    drives: dict[str, Drive] = {
        f"city {seed}": SimulatedDrive(seed=seed, scans=CITY_SCANS) for seed in SEEDS
    }
    for name in ("kitti00", "kit_muehlburger"):
        drives[f"`{name}`"] = open_drive(folder / name, min_returns=100)
    parameters = MapParameters.for_sensor(encoding="harmonic")
    grams = {}
    for name, drive in drives.items():
        scans = np.arange(0, len(drive), max(1, len(drive) // FITTED_TO))
        projected = project_drive(drive, scans, parameters.imager)
        counted = first_of_stands(drive.poses[projected.scans])
        grams[name] = drive_gram(projected.images, 0, counted)
    bases = {
        name: fit_radial_basis({name: gram}, parameters.ranks[0]) for name, gram in grams.items()
    }
    print("\nError that U leaves, kept from the row's drive over refitted to both:\n")
    rows = []
    for kept_from, u in bases.items():
        ratios = []
        for name in drives:
            [fit] = [
                fit
                for fit in HarmonicBasis.of(parameters, u).fits(
                    {kept_from: grams[kept_from], name: grams[name]}
                )
                if fit.drive == name
            ]
            ratios.append("" if name == kept_from else f"{fit.kept_error / fit.refitted_error:.3f}")
        rows.append([kept_from, *ratios])
    print_table(["kept from", *drives], rows)
    print(f"Recall@1 within {WITHIN_M:g} m on `kitti00`, even scans mapped, odd ones queried:\n")
    recorded = drives["`kitti00`"]
    print_table(
        ["U of", *(f"d = {aside_m:g} m" for aside_m in ASIDE_M)],
        [
            [name, *(f"{share:.3f}" for share in _recall(recorded, parameters, u))]
            for name, u in bases.items()
        ],
    )


def _recall(drive: Drive, parameters: MapParameters, u: Float32Array) -> list[float]:
    rows = np.arange(0, len(drive), 2)
    localizer = localizer_of(drive, rows, parameters, kept=HarmonicBasis.of(parameters, u))
    queried = range(1, len(drive), 2)
    hits = np.zeros(len(ASIDE_M))
    for index in queried:
        points_m = drive.scan(index).points_m
        for column, aside_m in enumerate(ASIDE_M):
            scan = Scan(seen_from_beside(points_m, aside_m).astype(np.float32))
            best = localizer.localize_scan(scan).best
            place_m = localizer.map.trajectory.poses[best.row, :3]
            hits[column] += np.linalg.norm(place_m - drive.poses[index, :3]) <= WITHIN_M
    return [float(share) for share in hits / len(queried)]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
