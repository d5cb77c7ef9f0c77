"""The tables of docs/reference/harmonic-measurements.md, from recorded and simulated drives.

    python -m benchmarks.harmonic DRIVES [recorded|cities]

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00`. The simulated
cities have seeds on which nothing was chosen.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, described, print_table
from benchmarks.drives import in_memory
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.arrays import FloatArray, IntArray
from core.encodings.distance import Distance
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.signature import Packing, pack_signatures, unpack_signatures
from core.encodings.tucker import leading_basis, row_gram
from core.evaluation.condition import Condition, conditions
from core.evaluation.evaluate import Evaluation, EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.localization.localizer import Localizer
from core.localization.match import Match
from core.parameters import MapParameters
from core.projection.imager import ImageKind
from core.projection.images import project_drive
from core.projection.reducer import Reducer
from core.scans.displacement import left_of_m
from core.scans.drive import Drive, MemoryDrive
from core.scans.pose import heading_deg
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

SEEDS = (101, 102, 103)
OFFSETS_M = (2.0, -2.0, 3.0, -3.0)
CITY_SCANS = 300
QUERY_EVERY = 5  # of a second pass: its neighbours, 0.1 s apart, add little

CONDITIONS: tuple[Condition, ...] = (
    *conditions((0, 10, 90, 180), (0,), (0,)),
    *conditions((0,), (1, -1, 2, -2, 2.25, -2.25, 3, -3), (0,)),
    *conditions((180,), (3, -3), (0,)),
    *conditions((0,), (0,), (0.5, 1.0)),
)


def harmonic(
    reducer: Reducer | None = None,
    distance: Distance | None = None,
    lateral_renderings_m: Sequence[float] | None = None,
    image: ImageKind | None = None,
    ranks: tuple[int, int] = (5, 5),
) -> MapParameters:
    """Return parameters that differ from the default in what is given."""
    return MapParameters.for_sensor(
        encoding="harmonic",
        reducer=reducer,
        distance=distance,
        lateral_renderings_m=lateral_renderings_m,
        image=image,
        ranks=ranks,
    )


ALONE = (0.0,)
SETTINGS: dict[str, MapParameters] = {
    "paper, `last`": MapParameters(),
    "**default**": harmonic(),
    "without renderings": harmonic(lateral_renderings_m=ALONE),
    "`plain`": harmonic(distance=Distance.PLAIN),
    "`mean`": harmonic(Reducer.MEAN),
    "`mean`, `plain`, without": harmonic(Reducer.MEAN, Distance.PLAIN, ALONE),
    "range, `mean`": harmonic(image=ImageKind.RANGE),
    "4x4": harmonic(ranks=(4, 4)),
    "6x6": harmonic(ranks=(6, 6)),
}


def main(folder: Path, part: str = "") -> None:
    """Print the tables."""
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.harmonic DRIVES` at commit {commit()} on {machine()}.")
    if part in {"", "cities"}:
        _cities()
    if part == "cities":
        return
    recorded = open_drive(folder / "kitti00", min_returns=100)
    drive = in_memory(recorded)
    _recorded(drive)
    _packed(drive)


def _evaluate(drive: Drive, parameters: MapParameters) -> Evaluation:
    protocol = EvaluationProtocol(parameters, segments=5, split=Every(2), conditions=CONDITIONS)
    return evaluate(drive, protocol)


def _recorded(drive: Drive) -> None:
    print("\n## `kitti00`\n")
    print("Recall@1 within 3 m of where the query was recorded, even scans mapped, odd ones")
    print("queried, five segments, 5x5. A setting differs from the default (heights, `highest`,")
    print("`normalised`, renderings) as it states.\n")
    found = {name: _evaluate(drive, parameters) for name, parameters in SETTINGS.items()}
    of_default = found["**default**"]
    rows = []
    for index, condition in enumerate(CONDITIONS):
        default = of_default.conditions[index]
        rows.append(
            [
                described(condition),
                *(f"{of_it.conditions[index].recall_at_1[3.0]:.3f}" for of_it in found.values()),
                f"{default.heading_error_deg_median:.2f}",
                f"{default.lateral_error_m_median:.2f}",
                f"{default.position_error_m_median:.2f}",
            ]
        )
    rows.append(["elements", *(f"{i.compression.elements}" for i in found.values()), "", "", ""])
    rows.append(
        ["relative error", *(f"{max(i.relative_error):.2f}" for i in found.values()), "", "", ""]
    )
    print_table(
        [
            "query",
            *SETTINGS,
            "default: heading error deg",
            "lateral error m",
            "position error m",
        ],
        rows,
    )


def _packed(drive: MemoryDrive) -> None:
    print("## Packed signatures on `kitti00`\n")
    print("The same with the default, the signature as it is and packed; bytes of the body.\n")
    localizer = _localizer(drive, harmonic(), np.arange(0, len(drive), 2))
    ways: tuple[Packing | None, ...] = (None, Packing.FLOAT16, Packing.INT8)
    hits = np.zeros((len(CONDITIONS), len(ways)))
    size = [0] * len(ways)
    queried = range(1, len(drive), 2)
    for scan_index in queried:
        scan = drive.scan(scan_index)
        for row, condition in enumerate(CONDITIONS):
            disturbed = condition.apply(scan, np.random.default_rng([0, scan_index]))
            signatures = localizer.basis.encode(localizer.basis.image(disturbed))
            for column, way in enumerate(ways):
                sent = signatures
                if way is not None:
                    body = pack_signatures(signatures, way)
                    sent, size[column] = unpack_signatures(body), len(body)
                best = localizer.localize_signatures(sent).best
                place = localizer.map.trajectory.poses[best.row, :3]
                hits[row, column] += np.linalg.norm(place - drive.poses[scan_index, :3]) <= 3.0
    rows = [
        [described(condition), *(f"{share:.3f}" for share in of_it / len(queried))]
        for condition, of_it in zip(CONDITIONS, hits, strict=True)
    ]
    rows.append(["all", *(f"{share:.4f}" for share in hits.mean(axis=0) / len(queried))])
    print_table(
        ["query", "complex64", *(f"{w}, {n} bytes" for w, n in zip(ways, size, strict=True) if w)],
        rows,
    )


def _cities() -> None:
    print("## Simulated cities\n")
    print(f"Recall@1 within 5 m: {CITY_SCANS} scans mapped, queried with a second pass that drives")
    print("beside the mapped line, in its direction and against it, other cars parked.\n")
    print("`all detail`: U fitted to the images as they are, broad waves included.\n")
    names = ("paper, `last`", "**default**", "without renderings", "`plain`", "`mean`")
    rows = []
    for seed in SEEDS:
        city = SimulatedDrive(seed=seed, scans=CITY_SCANS)
        mapped = in_memory(city)
        rows_of_map = np.arange(CITY_SCANS)
        localizers = [_localizer(mapped, SETTINGS[name], rows_of_map) for name in names]
        localizers.append(_localizer(mapped, harmonic(), rows_of_map, all_detail=True))
        for offset_m in OFFSETS_M:
            for reverse in (False, True):
                queried = _second_pass(seed, offset_m, reverse=reverse)
                found = [
                    [localizer.localize_scan(scan).best for scan in queried]
                    for localizer in localizers
                ]
                rows.append(
                    [
                        f"{seed}, {offset_m:g} m{', against' if reverse else ''}",
                        *(f"{_recall(of_it, queried.poses, within_m=5.0):.3f}" for of_it in found),
                        *_errors_of_default(found[1], queried.poses),
                    ]
                )
    print_table(
        ["seed, offset", *names, "all detail", "default: heading error deg", "lateral error m"],
        rows,
    )


def _localizer(
    drive: MemoryDrive, parameters: MapParameters, rows: IntArray, *, all_detail: bool = False
) -> Localizer:
    u = None
    if all_detail:
        images = project_drive(drive, rows, parameters.imager).images
        cells = images.read(0, len(rows)).reshape(-1, *parameters.grid.shape)
        u = leading_basis(row_gram(cells), parameters.ranks[0]).astype(np.float32)
    return localizer_of(
        drive,
        rows,
        parameters,
        segments=5,
        kept=None if u is None else HarmonicBasis.of(parameters, u),
    )


def _recall(matches: Sequence[Match], poses: FloatArray, *, within_m: float) -> float:
    places = np.array([[m.pose.x_m, m.pose.y_m, m.pose.z_m] for m in matches if m.pose])
    return float(np.mean(np.linalg.norm(places - poses[:, :3], axis=1) <= within_m))


def _errors_of_default(matches: Sequence[Match], poses: FloatArray) -> tuple[str, str]:
    yaw_errors_deg = np.array([m.heading_deg for m in matches]) - heading_deg(poses)
    beside = [
        m.lateral_m - left_of_m(np.array(m.pose.as_tuple()), pose)
        for m, pose in zip(matches, poses, strict=True)
        if m.pose is not None and m.lateral_m is not None
    ]
    yaw_error_deg = np.median(np.abs((yaw_errors_deg + 180.0) % 360.0 - 180.0))
    return f"{yaw_error_deg:.2f}", f"{np.median(np.abs(beside)):.2f}"


def _second_pass(seed: int, offset_m: float, *, reverse: bool) -> MemoryDrive:
    drive = SimulatedDrive(
        seed=seed,
        scans=CITY_SCANS,
        lateral_offset_m=offset_m,
        reverse=reverse,
        traffic_seed=seed + 1000,
    )
    scans = [drive.scan(i) for i in range(0, len(drive), QUERY_EVERY)]
    return MemoryDrive(drive.name, scans)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
