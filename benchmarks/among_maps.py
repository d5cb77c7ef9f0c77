"""Where among all maps: recall, trust and time in a city of simulated districts.

    python -m benchmarks.among_maps FOLDER [--maps 10000] [--query all-numbers] [--without-numba]

The city is that of `benchmarks/city_of_maps.py`, kept in FOLDER once it is simulated, as is the
store of so many maps. A query is answered by the service's own search, without HTTP; the map that
it is of also answers alone. It is a packed signature as a map asks for it, one of all numbers that
maps keep, as the client sends it, or a scan.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from app.access.caller import Caller
from app.localization.all_maps import AllMapsSearch
from app.localization.opened_maps import OpenedMaps
from app.localization.place_indexes import PlaceIndexes
from app.revisions.loaded import LoadedRevisions
from benchmarks.accuracy import print_table
from benchmarks.city_of_maps import DISTRICTS, SCANS, City, Queries, name_of
from benchmarks.results import Row
from benchmarks.timing import machine
from core.arrays import BoolArray, FloatArray
from core.encodings.basis import Basis
from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.evaluation.retrieval import auroc
from core.localization.all_maps import AllMapsLocalization
from core.localization.localizer import Localization, Localizer
from core.projection.imager import Image
from core.projection.visibility import HIDDEN, SECTORS, sector_of_column
from storage.store import Store

MAPS, FEWER = 10_000, 10
WITHIN_M, BINS = 5.0, 15
HIDDEN_SECTORS = {"as recorded": 0, "36 deg hidden": 6, "60 deg hidden": 10, "120 deg hidden": 20}
RECALL_LOSS, P99_BAR_MS = 0.02, 150.0
ALL_MAPS = Caller("benchmark", frozenset())


class Query(StrEnum):
    """What is sent of a scan."""

    SIGNATURE = "signature"
    ALL_NUMBERS = "all-numbers"
    SCAN = "scan"


@dataclass(frozen=True)
class Answer:
    """Of one query: whether it is right, its probability, and that of the map alone."""

    known: bool
    right: bool
    probability: float
    own: float  # the probability if the runner-up were of the best map only
    alone_right: bool
    alone: float
    seconds: float
    cpu_seconds: float  # of all threads


@dataclass(frozen=True, eq=False)
class Searched:
    """The search among the maps of a store.

    Attributes:
        city: The city of the maps.
        all_maps: The search.
        localizers: Each of its maps alone.
        indexed_s: What the index took.
        indexed_cpu_s: Likewise of CPU.
        place_bytes: Bytes of a place in the index.
        first_cpu_s: What the slowest of the first queries took, of CPU.
    """

    city: City
    all_maps: AllMapsSearch
    localizers: LoadedRevisions
    indexed_s: float
    indexed_cpu_s: float
    place_bytes: float
    first_cpu_s: float

    def answers(self, hidden: int, every: int, kind: Query) -> list[Answer]:
        """Return the answers to each n-th query of known places, then of unknown ones.

        Args:
            hidden: How many of the sectors are hidden, beginning anywhere.
            every: The n.
            kind: What is sent.
        """
        queried = self.city.queried
        asked = [*(one.queries for one in queried), *self.city.unknown]
        return [
            self._answer(kind, image, pose, number if number < len(queried) else None, alone)
            for number, queries in enumerate(asked)
            for alone in [Localizer(queried[number % len(queried)].tensor_map)]
            for image, pose in _disturbed(self.city.basis, queries, number, hidden, every)
        ]

    def _answer(
        self, kind: Query, image: Image, pose: FloatArray, number: int | None, alone: Localizer
    ) -> Answer:
        query = _query(kind, self.city.basis, image)
        started, cpu = time.perf_counter(), time.process_time()
        answer = _among(self.all_maps, query)
        seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
        best, of_one = answer.best, _in_one(alone, query)
        own = _in_one(self.localizers.live(best.name).localizer, query)
        is_known = number is not None
        is_of_it = number is not None and best.name == name_of(number)
        return Answer(
            is_known,
            is_of_it and _near(best.match.pose, pose),
            answer.decision.probability or 0.0,
            own.decision.probability or 0.0,
            is_known and _near(of_one.best.pose, pose),
            of_one.decision.probability or 0.0,
            seconds,
            cpu,
        )


def _disturbed(
    basis: Basis, queries: Queries, number: int, hidden: int, every: int
) -> Iterator[tuple[Image, FloatArray]]:
    rng = np.random.default_rng([number, hidden])
    some = slice(number % every, None, every)
    for cells, pose in zip(queries.cells[some], queries.poses[some], strict=True):
        columns = (sector_of_column(cells.shape[1]) - rng.integers(SECTORS)) % SECTORS < hidden
        seen = np.where(columns, HIDDEN, cells).astype(np.float32)
        yield Image(seen, basis.parameters.grid), pose


def measure() -> list[Row]:
    """Return what signatures of all numbers lose and take, and what ten times as many maps cost."""
    threadpool_limits(limits=1)
    with tempfile.TemporaryDirectory() as folder:
        city = City.made(Path(folder))
        with _searched(city, MAPS // FEWER) as few:
            of_few = few.answers(0, 8, Query.ALL_NUMBERS)
        with _searched(city, MAPS) as all_maps:
            by_view = {
                name: all_maps.answers(hidden, 4, Query.ALL_NUMBERS)
                for name, hidden in HIDDEN_SECTORS.items()
            }
    rows = [_recall_row(name, answers) for name, answers in by_view.items()]
    answers = [answer for of_view in by_view.values() for answer in of_view]
    middle, most = _milliseconds(answers)
    rows.append(
        Row(
            f"99 % of answers among {MAPS} maps, ms",
            most[0],
            P99_BAR_MS,
            f"median {middle[0]:.0f}; of CPU {middle[1]:.0f}, 99 % {most[1]:.0f}",
            of_machine=True,
        )
    )
    few_ms, ms = (_milliseconds(of)[0][1] for of in (of_few, by_view["as recorded"]))
    name = f"CPU of an answer, times that among a {FEWER}th of the maps"
    return [*rows, Row(name, ms / few_ms, FEWER, f"{few_ms:.0f} ms among {MAPS // FEWER}")]


def _recall_row(view: str, answers: Sequence[Answer]) -> Row:
    known = [one for one in answers if one.known]
    alone, among = (
        float(np.mean([getattr(one, name) for one in known])) for name in ("alone_right", "right")
    )
    beside = f"{among:.3f} of {len(known)} queries, {alone:.3f} in the right map alone"
    name = f"recall@1 among {MAPS} maps, {view}"
    return Row(name, among, alone - RECALL_LOSS, beside, at_least=True, is_exact=True)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--maps", type=int, default=MAPS)
    parser.add_argument("--districts", type=int, default=DISTRICTS)
    parser.add_argument("--every", type=int, default=4, help="Take each n-th query.")
    parser.add_argument("--query", type=Query, choices=[*Query], default=Query.SIGNATURE)
    parser.add_argument("--without-numba", action="store_true", help="As if it were not installed.")
    given = parser.parse_args()
    if given.without_numba:
        sys.modules["numba"] = None  # type: ignore[assignment]  # importing it is an `ImportError`
    threadpool_limits(limits=1)
    city = City.made(given.folder, given.districts)
    with _searched(city, given.maps) as searched:
        print(
            f"{given.maps} maps indexed in {searched.indexed_s:.0f} s,"
            f" {searched.indexed_cpu_s:.0f} of CPU; {searched.place_bytes:.0f} bytes a place;"
            f" {'NumPy alone' if given.without_numba else 'numba'}; {machine()}.\n"
        )
        print(f"The first query takes {1e3 * searched.first_cpu_s:.0f} ms of CPU.\n")
        print_table(
            [
                "queries",
                "known + unknown",
                "recall@1 alone",
                "among all",
                "ECE, AUROC alone",
                "among all",
                "runner-up of one map",
                "ms, 50 % / 99 %",
                "CPU ms",
            ],
            [
                _cells(name, searched.answers(hidden, given.every, given.query))
                for name, hidden in HIDDEN_SECTORS.items()
            ],
        )
    return 0


@contextmanager
def _searched(city: City, maps: int) -> Iterator[Searched]:
    with closing(city.store(maps)) as store:
        yield _opened(city, store, maps)


def _opened(city: City, store: Store, maps: int) -> Searched:
    store.catalog.watch()
    indexes = PlaceIndexes(store)
    started, cpu = time.perf_counter(), time.process_time()
    indexes.update(city.basis.digest)
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    files = [*(store.layout.index / city.basis.digest).rglob("*.npy")]
    localizers = LoadedRevisions(store, 8)
    all_maps = AllMapsSearch(store, OpenedMaps(localizers, 64_000), indexes, 64)
    firsts = []
    for hidden in (0, SECTORS // 3):  # numba compiles its loops when they are first used
        [(image, _)] = islice(_disturbed(city.basis, city.queried[0].queries, 0, hidden, 1), 1)
        begun = time.process_time()
        _among(all_maps, _query(Query.ALL_NUMBERS, city.basis, image))
        firsts.append(time.process_time() - begun)
    return Searched(
        city,
        all_maps,
        localizers,
        seconds,
        cpu,
        sum(file.stat().st_size for file in files) / (SCANS * maps),
        max(firsts),
    )


def _cells(name: str, answers: Sequence[Answer]) -> list[str]:
    known = [one for one in answers if one.known]
    middle, most = _milliseconds(answers)
    right = np.array([one.right for one in answers])
    return [
        name,
        f"{len(known)} + {len(answers) - len(known)}",
        f"{_share(one.alone_right for one in known):.3f}",
        f"{_share(one.right for one in known):.3f}",
        _trust(
            np.array([one.alone for one in answers]),
            np.array([one.alone_right for one in answers]),
        ),
        _trust(np.array([one.probability for one in answers]), right),
        _trust(np.array([one.own for one in answers]), right),
        f"{middle[0]:.0f} / {most[0]:.0f}",
        f"{middle[1]:.0f} / {most[1]:.0f}",
    ]


def _milliseconds(answers: Sequence[Answer]) -> FloatArray:
    """Return the medians and 99th percentiles, each of the time that passes and of CPU."""
    seconds = np.array([[one.seconds, one.cpu_seconds] for one in answers])
    return np.asarray(1e3 * np.quantile(seconds, (0.5, 0.99), axis=0))


def _share(of: Iterator[bool]) -> float:
    return float(np.mean([*of]))


def _query(kind: Query, basis: Basis, image: Image) -> Image | Sequence[Signature]:
    if kind == Query.SCAN:
        return image
    signatures = basis.encode(image, basis.kept_ranks if kind == Query.ALL_NUMBERS else None)
    return unpack_signatures(pack_signatures(signatures))


def _among(all_maps: AllMapsSearch, query: Image | Sequence[Signature]) -> AllMapsLocalization:
    if isinstance(query, Image):
        return all_maps.image(ALL_MAPS, lambda _: query, 1, None).found
    return all_maps.signature(ALL_MAPS, query, 1, None).found


def _in_one(localizer: Localizer, query: Image | Sequence[Signature]) -> Localization:
    if isinstance(query, Image):
        return localizer.localize_image(query)
    return localizer.localize_signatures(query)


def _near(found: object, pose: FloatArray) -> bool:
    place = np.array([getattr(found, name) for name in ("x_m", "y_m", "z_m")])
    return bool(np.linalg.norm(place - pose[:3]) <= WITHIN_M)


def _trust(probability: FloatArray, right: BoolArray) -> str:
    bins = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    gaps = np.bincount(bins, weights=probability - right, minlength=BINS)
    area = auroc(probability[right], probability[~right])
    return f"{np.abs(gaps).sum() / len(right):.3f}, {'-' if area is None else f'{area:.3f}'}"


if __name__ == "__main__":
    sys.exit(main())
