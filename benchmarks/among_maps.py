"""Where among all maps: recall, trust and time in a city of simulated districts.

    python -m benchmarks.among_maps FOLDER [--maps 10000] [--query all-numbers] [--without-numba]

Each district is a map of 100 scans, all with one shared basis, kept in FOLDER once it is simulated,
as is the store of so many maps.
Every sixth is not mapped: its queries are of unknown places. Of the mapped ones half are queried,
on another day and up to 3 m beside the line. Each further map joins the left half of the scans of
one of the other half with the right half of those of another: a street has two sides. A query is
answered by the service's own search, without HTTP; the map that it is of also answers alone. It is
a packed signature as a map asks for it, one of all numbers that maps keep, or a scan.
"""

import argparse
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from app.access.caller import Caller
from app.localization.all_maps import AllMapsSearch
from app.localization.opened_maps import OpenedMaps
from app.localization.place_indexes import PlaceIndexes
from app.revisions.loaded import LoadedRevisions
from benchmarks.accuracy import print_table
from benchmarks.timing import machine
from core.arrays import BoolArray, FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonics import two_sided
from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.errors import InvalidMap
from core.evaluation.retrieval import auroc
from core.localization.all_maps import AllMapsLocalization
from core.localization.localizer import Localization, Localizer
from core.mapping.pipeline import build
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Image
from core.projection.visibility import HIDDEN, SECTORS, sector_of_column
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.catalog import RevisionFacts
from storage.files.basis_file import read_basis, write_basis
from storage.files.map_file import read_map, write_map
from storage.store import Store

SCANS, SPEED_M_S, FIRINGS = 100, 20.0, 400
FIRST_SEED, BASIS_SEED, ANOTHER_DAY = 6000, 5000, 100_000
UNKNOWN_EVERY = 6
# Left of the line in metres, and whether against its direction.
PASSES = ((0.0, False), (1.0, True), (2.0, False), (-3.0, True), (-1.5, False), (3.0, False))
QUERY_EVERY = 45
WITHIN_M, BINS = 5.0, 15
HIDDEN_SECTORS = {"as recorded": 0, "36 deg hidden": 6, "60 deg hidden": 10, "120 deg hidden": 20}
_LEFT = (1 << SECTORS // 2) - 1  # bits of the sectors of the left half
ALL_MAPS = Caller("benchmark", frozenset())


class Query(StrEnum):
    """What is sent of a scan."""

    SIGNATURE = "signature"
    ALL_NUMBERS = "all-numbers"
    SCAN = "scan"


@dataclass(frozen=True, eq=False)
class Queries:
    """The images and the true poses of a district's queries."""

    cells: FloatArray
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class District:
    """A district that is mapped."""

    tensor_map: TensorMap
    queries: Queries


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--maps", type=int, default=10_000)
    parser.add_argument("--districts", type=int, default=132)
    parser.add_argument("--every", type=int, default=4, help="Take every so-many-th query.")
    parser.add_argument("--query", type=Query, choices=[*Query], default=Query.SIGNATURE)
    parser.add_argument("--without-numba", action="store_true", help="As if it were not installed.")
    given = parser.parse_args()
    if given.without_numba:
        sys.modules["numba"] = None  # type: ignore[assignment]  # importing it is an `ImportError`
    threadpool_limits(limits=1)
    given.folder.mkdir(exist_ok=True)
    basis = _basis(given.folder)
    numbers = range(given.districts)
    unmapped = numbers[UNKNOWN_EVERY - 1 :: UNKNOWN_EVERY]
    mapped = [_district(given.folder, basis, n) for n in numbers if n not in unmapped]
    queried, sides = mapped[: len(mapped) // 2], mapped[len(mapped) // 2 :]
    unknown = [_queries(given.folder, basis, n) for n in unmapped]
    data = given.folder / f"store-{given.districts}-{given.maps}"
    if not data.exists():
        _fill(data, basis, queried, sides, given.maps)
    store = Store(data)
    store.catalog.watch()
    indexes = PlaceIndexes(store)
    started, cpu = time.perf_counter(), time.process_time()
    indexes.update(basis.digest)
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    files = [*(store.layout.index / basis.digest).rglob("*.npy")]
    size = sum(file.stat().st_size for file in files) / (SCANS * given.maps)
    print(
        f"{given.maps} maps indexed in {seconds:.0f} s, {cpu:.0f} of CPU; {size:.0f} bytes a place;"
        f" {'NumPy alone' if given.without_numba else 'numba'}; {machine()}.\n"
    )
    localizers = LoadedRevisions(store, 8)
    all_maps = AllMapsSearch(store, OpenedMaps(localizers, 64_000), indexes, 64)
    for hidden in (0, SECTORS // 3):  # numba compiles its loops when they are first used
        one = queried[0]
        answers = _ask(
            all_maps,
            localizers,
            basis,
            hidden,
            SCANS,
            one.queries,
            0,
            one.tensor_map,
            is_known=True,
            kind=given.query,
        )
        print(f"The first query takes {1e3 * next(answers).cpu_seconds:.0f} ms of CPU.\n")
    _report(all_maps, localizers, basis, queried, unknown, given.every, kind=given.query)
    store.close()
    return 0


def _drive(
    seed: int, lateral_m: float = 0.0, *, reverse: bool = False, day: int = 0
) -> SimulatedDrive:
    return SimulatedDrive(
        seed=seed,
        scans=SCANS,
        speed_m_s=SPEED_M_S,
        sensor=SimulatedSensor(firings=FIRINGS),
        lateral_offset_m=lateral_m,
        reverse=reverse,
        traffic_seed=seed + day,
    )


def _basis(folder: Path) -> Basis:
    parameters = MapParameters.for_sensor()
    [*paths] = folder.glob("basis-*.h5")
    if paths:
        return read_basis(paths[0], paths[0].stem.removeprefix("basis-"))
    drives = [_drive(BASIS_SEED + number) for number in range(3)]
    basis = build(drives, parameters, calibrated=False).tensor_map.basis()
    write_basis(folder / f"basis-{basis.digest}.h5", basis)
    return basis


def _district(folder: Path, basis: Basis, number: int) -> District:
    map_file = folder / f"m{number:04}.h5"
    if not map_file.exists():
        made = build([_drive(FIRST_SEED + number)], MapParameters.for_sensor(), kept=basis)
        write_map(map_file, made.tensor_map)
    return District(read_map(map_file), _queries(folder, basis, number))


def _queries(folder: Path, basis: Basis, number: int) -> Queries:
    file = folder / f"q{number:04}.npz"
    if not file.exists():
        cells, poses = [], []
        for order, (lateral_m, reverse) in enumerate(PASSES):
            drive = _drive(FIRST_SEED + number, lateral_m, reverse=reverse, day=ANOTHER_DAY)
            for index in range(5 + order, SCANS, QUERY_EVERY):
                cells.append(basis.image(drive.scan(index)).cells)
                poses.append(drive.poses[index])
        np.savez(file, cells=np.array(cells), poses=np.array(poses))
    found = np.load(file)
    return Queries(found["cells"], found["poses"])


def _fill(
    data: Path, basis: Basis, queried: list[District], sides: list[District], count: int
) -> None:
    filling = data.with_name(f"{data.name}.part")
    shutil.rmtree(filling, ignore_errors=True)
    filling.mkdir()
    store = Store(filling)
    store.bases.add("city", basis)
    for number, tensor_map in enumerate(_maps(queried, sides, count)):
        record = store.maps.create(f"d{number:05}")
        facts = RevisionFacts("harmonic", len(tensor_map), 1, {}, bases=tensor_map.basis_digests)
        store.revisions.add(
            record.id,
            tensor_map.revision,
            partial(write_map, tensor_map=tensor_map),
            facts,
        )
    store.close()
    filling.rename(data)


def _maps(queried: list[District], sides: list[District], count: int) -> Iterator[TensorMap]:
    yield from (one.tensor_map for one in queried)
    rng = np.random.default_rng(0)
    for _ in range(count - len(queried)):
        left, right = rng.choice(len(sides), 2, replace=False)
        yield _joined(sides[left].tensor_map, sides[right].tensor_map, rng)


def _joined(left: TensorMap, right: TensorMap, rng: np.random.Generator) -> TensorMap:
    """Return a map whose scans have the left half of one map's and the right half of another's."""
    one, other = left.model, right.model
    if not (isinstance(one, HarmonicModel) and isinstance(other, HarmonicModel)):
        raise InvalidMap("the maps are not harmonic")
    columns, kept = one.columns, one.ranks[1]
    sees = np.arange(columns) < columns // 2
    rows, of_other = np.arange(len(one)), (np.arange(len(one)) + rng.integers(SCANS)) % len(other)
    signatures = np.zeros_like(one.signatures)
    for model, of_it, half in ((one, rows, sees), (other, of_other, ~sees)):
        mask = np.fft.fft(half) / columns
        mixed = mask[(np.arange(kept)[:, None] - np.arange(1 - kept, kept)) % columns]
        signatures += (two_sided(model.signatures[of_it].astype(np.complex128)) @ mixed.T).astype(
            np.complex64
        )
    signatures.imag[..., 0] = 0.0
    hidden = _bits(one, rows) & _LEFT | _bits(other, of_other) & ~_LEFT
    of_left = np.arange(SECTORS) < SECTORS // 2
    images = np.where(of_left, one.small_images(rows), other.small_images(of_other))
    model = replace(
        one,
        stored=SignatureNumbers(signatures),
        hidden_sectors=hidden,
        verification_images=images,
    )
    return replace(left, model=model)


def _bits(model: HarmonicModel, rows: IntArray) -> IntArray:
    return np.asarray(model.hidden_sectors)[rows]


@dataclass(frozen=True)
class _Answer:
    """Of one query: whether it is right, its probability, and that of the map alone."""

    known: bool
    right: bool
    probability: float
    own: float  # the probability if the runner-up were of the best map only
    alone_right: bool
    alone: float
    seconds: float
    cpu_seconds: float  # of all threads


def _report(
    all_maps: AllMapsSearch,
    localizers: LoadedRevisions,
    basis: Basis,
    queried: list[District],
    unknown: list[Queries],
    every: int,
    *,
    kind: Query,
) -> None:
    rows = []
    for name, hidden in HIDDEN_SECTORS.items():
        ask = partial(_ask, all_maps, localizers, basis, hidden, every, kind=kind)
        answers = [
            answer
            for number, one in enumerate(queried)
            for answer in ask(one.queries, number, one.tensor_map, is_known=True)
        ]
        for number, queries in enumerate(unknown, len(queried)):
            other = queried[number % len(queried)].tensor_map
            answers += ask(queries, number, other, is_known=False)
        known = [one for one in answers if one.known]
        seconds = np.array([[one.seconds, one.cpu_seconds] for one in answers])
        middle, most = 1e3 * np.quantile(seconds, (0.5, 0.99), axis=0)
        right = np.array([one.right for one in answers])
        rows.append(
            [
                name,
                f"{len(known)} + {len(answers) - len(known)}",
                f"{np.mean([one.alone_right for one in known]):.3f}",
                f"{np.mean([one.right for one in known]):.3f}",
                _trust(
                    np.array([one.alone for one in answers]),
                    np.array([one.alone_right for one in answers]),
                ),
                _trust(np.array([one.probability for one in answers]), right),
                _trust(np.array([one.own for one in answers]), right),
                f"{middle[0]:.0f} / {most[0]:.0f}",
                f"{middle[1]:.0f} / {most[1]:.0f}",
            ]
        )
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
        rows,
    )


def _ask(
    all_maps: AllMapsSearch,
    localizers: LoadedRevisions,
    basis: Basis,
    hidden: int,
    every: int,
    queries: Queries,
    number: int,
    tensor_map: TensorMap,
    *,
    is_known: bool,
    kind: Query,
) -> Iterator[_Answer]:
    rng = np.random.default_rng([number, hidden])
    alone = Localizer(tensor_map)
    some = slice(number % every, None, every)
    for cells, pose in zip(queries.cells[some], queries.poses[some], strict=True):
        columns = (sector_of_column(cells.shape[1]) - rng.integers(SECTORS)) % SECTORS < hidden
        image = Image(np.where(columns, HIDDEN, cells).astype(np.float32), basis.parameters.grid)
        query = _query(kind, basis, image)
        started, cpu = time.perf_counter(), time.process_time()
        answer = _among(all_maps, query)
        seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
        best = answer.best
        of_one = _in_one(alone, query)
        yield _Answer(
            is_known,
            is_known and best.name == f"d{number:05}" and _near(best.match.pose, pose),
            answer.decision.probability or 0.0,
            _in_one(localizers.live(best.name).localizer, query).decision.probability or 0.0,
            is_known and _near(of_one.best.pose, pose),
            of_one.decision.probability or 0.0,
            seconds,
            cpu,
        )


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
