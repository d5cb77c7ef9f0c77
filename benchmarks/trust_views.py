"""Probabilities of answers to disturbed queries, in simulated cities whose seeds a commit gives.

    python -m benchmarks.trust_views COMMIT [--every 1] [--scans | --ranks 5,5] [--disturb fov:60]

The seeds derive from the digest of COMMIT, the one that froze the defaults: nothing was chosen on
them. Every query is a scan of a second pass beside the line, among other cars, under one
disturbance drawn at random. The map of its city and that of another one answer it, so that half of
the answers are of unknown places. Vehicles send signatures, with --ranks of other
ranks than the map's queries, or, with --scans, scans. Correct is a
match within 5 m. It returns 1 if a bar is missed, or too few answers are sure to decide on it.
"""

import argparse
import hashlib
import itertools
import sys
from collections.abc import Iterator, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import print_table
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.arrays import FloatArray
from core.confidence.calibration import MIN_PROBABILITY
from core.errors import InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.retrieval import auroc
from core.localization.candidates import find_candidates
from core.localization.localizer import Localizer
from core.parameters import MapParameters
from core.projection.imager import Image
from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive

CITIES = 3
CITY_SCANS = 300
WITHIN_M = 5.0
BINS = 15
MOST_ECE, LEAST_AUROC = 0.05, 0.98
SURE, LEAST_SURE, MOST_WRONG_OF_SURE = 0.99, 5000, 0.001
DISTURBANCES = (
    "", "hidden:60", "hidden:120", "fov:180", "fov:120", "fov:70", "truck:1", "truck:2",
    "pitch:3", "roll:5", "height:0.5", "reach:30", "drop:0.95", "snow:0.2", "skew:15", "beams:16",
)  # fmt: skip
PASSES = tuple(itertools.product((0.0, 1.0, -1.0, 1.5, 2.0, -2.0, 3.0, -3.0), (False, True)))
"""How far left of the line, metres, and whether against its direction."""

Answers = dict[str, list[tuple[float, bool, bool]]]
"""By disturbance: the probability, whether the match is right, and whether the place is known."""


def main() -> int:
    """Print the figures; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit")
    parser.add_argument("--every", type=int, default=1, help="Query with every N-th scan.")
    sent = parser.add_mutually_exclusive_group()
    sent.add_argument("--scans", action="store_true")
    sent.add_argument("--ranks", type=_ranks, metavar="R1,R2")
    parser.add_argument("--disturb", type=_names, default=DISTURBANCES, metavar="NAME:VALUE,...")
    given = parser.parse_args()
    threadpool_limits(limits=1)
    seeds = [_seed(given.commit, city) for city in range(CITIES)]
    print(f"Cities {', '.join(map(str, seeds))}, of commit {given.commit}; {machine()}.\n")
    localizers = [_localizer(seed) for seed in seeds]
    found: Answers = {name: [] for name in given.disturb}
    for number, seed in enumerate(seeds):
        known, unknown = localizers[number], localizers[(number + 1) % CITIES]
        for disturbance, image, place in _queries(seed, given.every, known, given.disturb):
            for localizer, is_known in ((known, True), (unknown, False)):
                probability, matched = _answer(localizer, image, given.ranks, by_scan=given.scans)
                right = is_known and np.linalg.norm(matched - place) <= WITHIN_M
                found[disturbance].append((probability, bool(right), is_known))
    rows: list[list[str]] = []
    missed = False
    everything = [answer for answers in found.values() for answer in answers]
    for name, answers in {"all": everything, **found}.items():
        figures, misses = _figures(answers)
        rows.append([name or "-", str(len(answers)), *figures])
        missed |= name == "all" and misses
    print_table(
        [
            *("query", "answers", "right, of known places", "localized and right"),
            *("localized, of unknown places", "ECE", "AUROC", "sure", "of these wrong"),
        ],
        rows,
    )
    return int(missed)


def _seed(commit: str, city: int) -> int:
    return int.from_bytes(hashlib.sha256(f"{commit} {city}".encode()).digest()[:4], "big")


def _localizer(seed: int) -> Localizer:
    city = SimulatedDrive(seed=seed, scans=CITY_SCANS)
    return localizer_of(
        MemoryDrive(city.name, list(city)),
        np.arange(CITY_SCANS),
        MapParameters.for_sensor(),
        segments=5,
        calibrated=True,
    )


def _queries(
    seed: int, every: int, localizer: Localizer, disturbances: Sequence[str]
) -> Iterator[tuple[str, Image, FloatArray]]:
    """Yield a disturbance, the disturbed image and its place, of scans of all passes."""
    rng = np.random.default_rng([seed, 1])
    for number, (offset_m, reverse) in enumerate(PASSES):
        drive = SimulatedDrive(
            seed=seed,
            scans=CITY_SCANS,
            lateral_offset_m=offset_m,
            reverse=reverse,
            traffic_seed=seed + 1000 + number,
        )
        for index in range(number % every, CITY_SCANS, every):
            disturbance = disturbances[int(rng.integers(len(disturbances)))]
            try:
                scan = Condition(disturb=disturbance).apply(drive.scan(index), rng)
                image = localizer.basis.image(scan)
            except InvalidScan:
                continue
            yield disturbance, image, drive.poses[index, :3]


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split(","))


def _ranks(text: str) -> tuple[int, int]:
    r1, r2 = text.split(",")
    return int(r1), int(r2)


def _answer(
    localizer: Localizer, image: Image, ranks: tuple[int, int] | None, *, by_scan: bool
) -> tuple[float, FloatArray]:
    """Return the probability of the best match, and its place; poses are not estimated."""
    if by_scan:
        search = localizer.search_image(image)
    else:
        search = localizer.search(localizer.basis.encode(image, ranks))
    candidates = find_candidates(localizer.map, search, 1)
    decision = candidates.decide(localizer.map.calibration_of(search), None, None)
    assert decision.probability is not None  # noqa: S101 - the map is calibrated
    return decision.probability, localizer.map.trajectory.poses[candidates.matches.rows[0], :3]


def _figures(answers: Sequence[tuple[float, bool, bool]]) -> tuple[list[str], bool]:
    """Return the figures as texts, and whether one misses its bar."""
    probability = np.array([answer[0] for answer in answers])
    right, known = (np.array([answer[n] for answer in answers]) for n in (1, 2))
    localized = probability >= MIN_PROBABILITY
    bins = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    gaps = np.bincount(bins, weights=probability - right, minlength=BINS)
    ece = float(np.abs(gaps).sum() / len(probability))
    area = auroc(probability[right], probability[~right])
    sure = probability > SURE
    wrong = int((sure & ~right).sum())
    texts = [
        f"{right[known].mean():.3f}",
        f"{(right & localized)[known].mean():.3f}",
        f"{localized[~known].mean():.3f}",
        f"{ece:.3f}",
        "-" if area is None else f"{area:.3f}",
        str(int(sure.sum())),
        str(wrong),
    ]
    too_sure = sure.sum() < LEAST_SURE or wrong > MOST_WRONG_OF_SURE * sure.sum()
    return texts, ece > MOST_ECE or area is None or area < LEAST_AUROC or too_sure


if __name__ == "__main__":
    sys.exit(main())
