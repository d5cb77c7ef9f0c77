"""A city of simulated districts: each is a map of 100 scans, and all have one shared basis.

Every sixth district is not mapped: its queries are of unknown places. Of the mapped ones half are
queried, on another day and up to 3 m beside the line. Each further map joins the left half of the
scans of one of the other half with the right half of those of another: a street has two sides.
10,000 maps and their index take 10 GB of disk.
"""

import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from core.arrays import FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonics import two_sided
from core.errors import InvalidMap
from core.mapping.pipeline import build
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.visibility import SECTORS
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.catalog import RevisionFacts
from storage.files.basis_file import read_basis, write_basis
from storage.files.map_file import read_map, write_map
from storage.store import Store

SCANS = 100
"""Scans of a map."""
DISTRICTS = 132
"""Districts that are simulated, of which 22 are not mapped and 55 are queried."""

_SPEED_M_S, _FIRINGS, _PROCESSES = 20.0, 400, 2
_FIRST_SEED, _BASIS_SEED, _ANOTHER_DAY = 6000, 5000, 100_000
_UNKNOWN_EVERY, _QUERY_EVERY = 6, 45
# Left of the line in metres, and whether against its direction.
_PASSES = ((0.0, False), (1.0, True), (2.0, False), (-3.0, True), (-1.5, False), (3.0, False))
_LEFT = (1 << SECTORS // 2) - 1  # bits of the sectors of the left half


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


@dataclass(frozen=True, eq=False)
class City:
    """Districts, their queries, and stores of any number of maps.

    Attributes:
        folder: Where all of it is kept once it is made.
        basis: The basis that all maps share.
        mapped: The districts that are mapped; the first half is queried.
        unknown: Queries of districts that are not mapped.
    """

    folder: Path
    basis: Basis
    mapped: list[District]
    unknown: list[Queries]

    @classmethod
    def made(cls, folder: Path, districts: int = DISTRICTS) -> "City":
        """Return the city of a folder, whose districts are simulated where it lacks them."""
        folder.mkdir(exist_ok=True)
        basis = _basis(folder)
        numbers = range(districts)
        unmapped = numbers[_UNKNOWN_EVERY - 1 :: _UNKNOWN_EVERY]
        with ProcessPoolExecutor(_PROCESSES, mp_context=get_context("spawn")) as processes:
            mapped = [number for number in numbers if number not in unmapped]
            for making, of in ((_make_map, mapped), (_make_queries, numbers)):
                [*processes.map(partial(making, folder, basis), of)]
        return cls(
            folder,
            basis,
            [District(read_map(_map_file(folder, n)), _queries(folder, n)) for n in mapped],
            [_queries(folder, n) for n in unmapped],
        )

    @property
    def queried(self) -> list[District]:
        """The districts that are mapped and queried."""
        return self.mapped[: len(self.mapped) // 2]

    def store(self, maps: int) -> Store:
        """Return a store of so many maps, the first of which are those that are queried."""
        data = self.folder / f"store-{len(self.mapped)}-{maps}"
        if not data.exists():
            filling = data.with_name(f"{data.name}.part")
            shutil.rmtree(filling, ignore_errors=True)
            filling.mkdir()
            self._fill(filling, maps)
            filling.rename(data)
        return Store(data)

    def _fill(self, data: Path, maps: int) -> None:
        store = Store(data)
        store.bases.add("city", self.basis)
        for number, tensor_map in enumerate(self._maps(maps)):
            record = store.maps.create(name_of(number))
            facts = RevisionFacts(
                "harmonic", len(tensor_map), 1, {}, bases=tensor_map.basis_digests
            )
            written = partial(write_map, tensor_map=tensor_map)
            store.revisions.add(record.id, tensor_map.revision, written, facts)
        store.close()

    def _maps(self, count: int) -> Iterator[TensorMap]:
        queried, sides = self.queried, self.mapped[len(self.mapped) // 2 :]
        yield from (one.tensor_map for one in queried)
        rng = np.random.default_rng(0)
        for _ in range(count - len(queried)):
            left, right = rng.choice(len(sides), 2, replace=False)
            yield _joined(sides[left].tensor_map, sides[right].tensor_map, rng)


def name_of(number: int) -> str:
    """Return the name of a map in the store."""
    return f"d{number:05}"


def _drive(
    seed: int, lateral_m: float = 0.0, *, reverse: bool = False, day: int = 0
) -> SimulatedDrive:
    return SimulatedDrive(
        seed=seed,
        scans=SCANS,
        speed_m_s=_SPEED_M_S,
        sensor=SimulatedSensor(firings=_FIRINGS),
        lateral_offset_m=lateral_m,
        reverse=reverse,
        traffic_seed=seed + day,
    )


def _basis(folder: Path) -> Basis:
    parameters = MapParameters.for_sensor()
    [*paths] = folder.glob("basis-*.h5")
    if paths:
        return read_basis(paths[0], paths[0].stem.removeprefix("basis-"))
    drives = [_drive(_BASIS_SEED + number) for number in range(3)]
    basis = build(drives, parameters, calibrated=False).tensor_map.basis()
    write_basis(folder / f"basis-{basis.digest}.h5", basis)
    return basis


def _make_map(folder: Path, basis: Basis, number: int) -> None:
    """Build the map of a district that the folder lacks."""
    threadpool_limits(limits=1)
    if not _map_file(folder, number).exists():
        drive = _drive(_FIRST_SEED + number)
        made = build([drive], MapParameters.for_sensor(), kept=basis)
        write_map(_map_file(folder, number), made.tensor_map)


def _make_queries(folder: Path, basis: Basis, number: int) -> None:
    """Render the queries of a district that the folder lacks."""
    threadpool_limits(limits=1)
    if _query_file(folder, number).exists():
        return
    cells, poses = [], []
    for order, (lateral_m, reverse) in enumerate(_PASSES):
        drive = _drive(_FIRST_SEED + number, lateral_m, reverse=reverse, day=_ANOTHER_DAY)
        for index in range(5 + order, SCANS, _QUERY_EVERY):
            cells.append(basis.image(drive.scan(index)).cells)
            poses.append(drive.poses[index])
    np.savez(_query_file(folder, number), cells=np.array(cells), poses=np.array(poses))


def _map_file(folder: Path, number: int) -> Path:
    return folder / f"m{number:04}.h5"


def _query_file(folder: Path, number: int) -> Path:
    return folder / f"q{number:04}.npz"


def _queries(folder: Path, number: int) -> Queries:
    found = np.load(_query_file(folder, number))
    return Queries(found["cells"], found["poses"])


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
