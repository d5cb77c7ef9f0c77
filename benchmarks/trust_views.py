"""Probabilities of answers to disturbed queries, in simulated cities whose seeds a commit gives.

    python -m benchmarks.trust_views COMMIT [--queries 5000] [--scans]

The seeds derive from the digest of COMMIT, the one that froze the defaults: nothing was chosen on
them. Every query is of a second pass beside the line or of another city, under one disturbance
drawn at random; vehicles send signatures or, with --scans, scans. Correct is a match within 5 m. It
returns 1 if a bar is missed.
"""

import argparse
import hashlib
import sys

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import print_table
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.arrays import BoolArray, FloatArray
from core.errors import InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.retrieval import auroc
from core.localization.localizer import Localizer
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive

CITIES = 3
CITY_SCANS = 300
WITHIN_M = 5.0
BINS = 15
MOST_ECE, LEAST_AUROC = 0.05, 0.98
SURE, MOST_WRONG_OF_SURE = 0.99, 0.001
DISTURBANCES = (
    "", "hidden:60", "hidden:120", "fov:180", "fov:120", "fov:70", "truck:1", "truck:2",
    "pitch:3", "roll:5", "height:0.5", "reach:30", "drop:0.95", "snow:0.2", "skew:15", "beams:16",
)  # fmt: skip
# Left of the line in metres, and whether against its direction.
PASSES = ((0.0, False), (1.0, True), (2.0, False), (-3.0, True), (-1.5, False), (3.0, False))


def main() -> int:
    """Print the figures; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit")
    parser.add_argument("--queries", type=int, default=5000)
    parser.add_argument("--scans", action="store_true")
    given = parser.parse_args()
    threadpool_limits(limits=1)
    seeds = [_seed(given.commit, city) for city in range(CITIES)]
    print(f"Cities {', '.join(map(str, seeds))}, of commit {given.commit}; {machine()}.\n")
    every = max(1, round(2 * CITIES * len(PASSES) * CITY_SCANS / given.queries))
    passes = {seed: _passes(seed, every) for seed in seeds}
    found: dict[str, list[tuple[float, bool, bool]]] = {}
    for number, seed in enumerate(seeds):
        city = SimulatedDrive(seed=seed, scans=CITY_SCANS)
        localizer = localizer_of(
            MemoryDrive(city.name, list(city)),
            np.arange(CITY_SCANS),
            MapParameters.for_sensor(),
            segments=5,
            calibrated=True,
        )
        for known, of_city in ((True, seed), (False, seeds[(number + 1) % CITIES])):
            _query(localizer, passes[of_city], seed, scans=given.scans, known=known, found=found)
    rows: list[list[str]] = []
    missed = False
    for disturbance in ("all", *DISTURBANCES):
        of_it = [
            answer
            for name, answers in found.items()
            for answer in answers
            if disturbance in {"all", name}
        ]
        probability = np.array([answer[0] for answer in of_it])
        is_right, is_known = (np.array([answer[n] for answer in of_it]) for n in (1, 2))
        figures = _figures(probability, is_right, is_known)
        rows.append([disturbance or "-", str(len(of_it)), *figures[0]])
        missed |= disturbance == "all" and figures[1]
    print_table(
        ["query", "queries", "right, of known places", "ECE", "AUROC", "sure", "of these wrong"],
        rows,
    )
    return int(missed)


def _seed(commit: str, city: int) -> int:
    return int.from_bytes(hashlib.sha256(f"{commit} {city}".encode()).digest()[:4], "big")


def _passes(seed: int, every: int) -> list[SimulatedDrive | MemoryDrive]:
    drives = [
        SimulatedDrive(
            seed=seed,
            scans=CITY_SCANS,
            lateral_offset_m=offset_m,
            reverse=reverse,
            traffic_seed=seed + 1000,
        )
        for offset_m, reverse in PASSES
    ]
    return [
        MemoryDrive(one.name, [one.scan(i) for i in range(0, CITY_SCANS, every)]) for one in drives
    ]


def _query(
    localizer: Localizer,
    drives: list[SimulatedDrive | MemoryDrive],
    seed: int,
    *,
    scans: bool,
    known: bool,
    found: dict[str, list[tuple[float, bool, bool]]],
) -> None:
    rng = np.random.default_rng([seed, known])
    for drive in drives:
        for index in range(len(drive)):
            disturbance = DISTURBANCES[rng.integers(len(DISTURBANCES))]
            scan = drive.scan(index)
            try:
                disturbed = Condition(disturb=disturbance).apply(scan, rng)
                image = localizer.basis.image(disturbed)
            except InvalidScan:
                continue
            if scans:
                answer = localizer.localize_image(image)
            else:
                answer = localizer.localize_signatures(localizer.basis.encode(image))
            assert answer.decision.probability is not None  # noqa: S101 - the map is calibrated
            assert answer.best.pose is not None  # noqa: S101 - and has poses
            place = np.array(answer.best.pose.as_tuple()[:3])
            right = known and np.linalg.norm(place - drive.poses[index, :3]) <= WITHIN_M
            found.setdefault(disturbance, []).append(
                (answer.decision.probability, bool(right), known)
            )


def _figures(probability: FloatArray, right: BoolArray, known: BoolArray) -> tuple[list[str], bool]:
    """Return the figures as texts, and whether one misses its bar."""
    bins = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    gaps = np.bincount(bins, weights=probability - right, minlength=BINS)
    ece = float(np.abs(gaps).sum() / len(probability))
    area = auroc(probability[right], probability[~right])
    sure = probability > SURE
    wrong = int((sure & ~right).sum())
    texts = [
        f"{right[known].mean():.3f}",
        f"{ece:.3f}",
        "-" if area is None else f"{area:.3f}",
        str(int(sure.sum())),
        str(wrong),
    ]
    too_sure = wrong > MOST_WRONG_OF_SURE * sure.sum()
    return texts, ece > MOST_ECE or area is None or area < LEAST_AUROC or too_sure


if __name__ == "__main__":
    sys.exit(main())
