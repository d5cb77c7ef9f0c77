"""Maps of up to a million scans, mixed from those of a small simulated city.

A signature is linear in its image. So each run of 100 scans of a large map is the sum of two runs
of 1,000 simulated scans 1.5 m apart, in shares of 30 to 70 %, each turned by an angle of its own,
and half of the sums mirrored with all their viewpoints: neighbours stay neighbours, a scan's
renderings differ as they do, and every place has partners that are half like it. A query is the
same sum of signatures from 2 m to the left on another day, turned again; one of an unknown place is
a sum of signatures of another city.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.maps import localizer_of
from core.arrays import BoolArray, Complex64Array, ComplexArray, FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.distance import Distance
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.model import HarmonicModel
from core.parameters import MapParameters
from core.projection.imager import Views
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

SIMULATED, STEP_M, RUN = 1000, 1.5, 100
LEFT_M, ANOTHER_DAY = 2.0, 1000
_LEAST_SHARE, _MOST_SHARE = 0.3, 0.7


@dataclass(frozen=True, eq=False)
class City:
    """The signatures that maps and queries are mixed of.

    Attributes:
        model: The mapped drive's model.
        sent_of: The queried scans, and where in `queries` each is.
        queries: `(n, r1, r2)` from beside them on another day, of full views.
        unknown: `(n, r1, r2)` of another city.
    """

    model: HarmonicModel
    sent_of: dict[int, int]
    queries: ComplexArray
    unknown: ComplexArray

    @classmethod
    def simulated(cls, views: Views) -> "City":
        """Return a city, simulated in half a minute."""
        parameters = MapParameters.for_sensor(encoding="harmonic", views=views)
        localizer = localizer_of(_drive(1), np.arange(SIMULATED), parameters)
        model = localizer.map.model
        assert isinstance(model, HarmonicModel)  # noqa: S101 - for mypy
        beside = _drive(1, left_m=LEFT_M, day=ANOTHER_DAY)
        rows, queries = _signatures(localizer.basis, beside, range(0, SIMULATED, 2))
        _, unknown = _signatures(localizer.basis, _drive(2), range(0, SIMULATED, 5))
        return cls(model, {row: at for at, row in enumerate(rows)}, queries, unknown)


def _drive(seed: int, left_m: float = 0.0, day: int = 0) -> SimulatedDrive:
    return SimulatedDrive(
        seed=seed,
        scans=SIMULATED,
        loop_m=SIMULATED * STEP_M,
        stops=False,
        lateral_offset_m=left_m,
        traffic_seed=seed + day,
        sensor=SimulatedSensor(firings=360),
    )


def _signatures(
    basis: Basis, drive: SimulatedDrive, rows: Sequence[int]
) -> tuple[list[int], ComplexArray]:
    """Return which scans see all around, and their signatures."""
    encoded = {row: basis.encode(basis.image(drive.scan(row)))[0] for row in rows}
    full = {row: one.values for row, one in encoded.items() if one.view.is_full}
    return list(full), np.stack([*full.values()]).astype(np.complex128)


@dataclass(frozen=True, eq=False)
class MixedMap:
    """A large map, and how each of its runs was mixed.

    Attributes:
        model: Without hidden sectors.
        first: `(n, 2)` the first scans of both runs.
        turn_rad: `(n, 2)` by which they are turned.
        mirrored: `(n,)`.
        share: `(n,)` of the first one's energy.
    """

    city: City
    model: HarmonicModel
    first: IntArray
    turn_rad: FloatArray
    mirrored: BoolArray
    share: FloatArray

    @classmethod
    def of(cls, city: City, scans: int) -> "MixedMap":
        """Return a map of so many scans, hundreds."""
        rng, runs, small = np.random.default_rng(scans), scans // RUN, city.model
        _, renderings, r1, r2 = small.stored.shape
        codes = np.empty((2 * r2 - 1, r1, renderings, scans), np.int8)
        scales = np.empty((scans, renderings), np.float32)
        first = rng.integers(0, SIMULATED - RUN + 1, (runs, 2))
        turn_rad = rng.uniform(0.0, 2.0 * np.pi, (runs, 2))
        mirrored, share = rng.random(runs) < 0.5, rng.uniform(_LEAST_SHARE, _MOST_SHARE, runs)
        for run in range(runs):
            rows = slice(run * RUN, (run + 1) * RUN)
            one, other = (small.signatures[start : start + RUN] for start in first[run])
            mixed = _mixed(one, other, turn_rad[run], share[run], mirrored=mirrored[run])
            if mirrored[run]:
                mixed = mixed[:, ::-1]
            stored = SignatureCodes.of(mixed)
            codes[..., rows], scales[rows] = stored.codes, stored.scales
        model = HarmonicModel(
            small.radial_basis,
            SignatureCodes(codes, scales),
            small.lateral_offset_m,
            np.array([0, scans]),
            small.columns,
            Distance.NORMALISED,
            small.sent_ranks,
            None if small.hidden_sectors is None else np.zeros(scales.shape, np.int64),
        )
        return cls(city, model, first, turn_rad, mirrored, share)

    def queries(self, count: int) -> tuple[list[ComplexArray], IntArray]:
        """Return queries of known places, and the scan that each is beside."""
        rng, rows = np.random.default_rng(1), []
        found: list[ComplexArray] = []
        while len(found) < count:
            run, at = int(rng.integers(len(self.first))), int(rng.integers(RUN))
            both = [self.city.sent_of.get(int(start) + at) for start in self.first[run]]
            if None in both:
                continue
            one, other = (self.city.queries[n] for n in both)
            turn_rad = self.turn_rad[run] + rng.uniform(0.0, 2.0 * np.pi)
            mixed = _mixed(one, other, turn_rad, self.share[run], mirrored=self.mirrored[run])
            found.append(mixed.astype(np.complex128))
            rows.append(run * RUN + at)
        return found, np.array(rows)

    def unknown(self, count: int) -> list[ComplexArray]:
        """Return queries of places that it does not have."""
        rng, of_others = np.random.default_rng(2), self.city.unknown
        found: list[ComplexArray] = []
        for _ in range(count):
            one, other = of_others[rng.integers(len(of_others), size=2)]
            turn_rad, share = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(0.3, 0.7)
            mixed = _mixed(one, other, turn_rad, share, mirrored=False)
            found.append(mixed.astype(np.complex128))
        return found


def _mixed(
    one: NDArray[np.complexfloating],
    other: NDArray[np.complexfloating],
    turn_rad: FloatArray,
    share: float,
    *,
    mirrored: bool,
) -> Complex64Array:
    parts = [part.conj() if mirrored else part for part in (one, other)]
    turned = [
        part * np.exp(1j * angle * np.arange(part.shape[-1]))
        for part, angle in zip(parts, turn_rad, strict=True)
    ]
    mixed = np.sqrt(share) * turned[0] + np.sqrt(1.0 - share) * turned[1]
    return np.asarray(mixed, np.complex64)


def read_bytes(model: HarmonicModel, sent: tuple[int, int]) -> NDArray[np.uint64]:
    """Return the codes that a query of these ranks is compared with, as long numbers."""
    assert isinstance(model.stored, SignatureCodes)  # noqa: S101 - for mypy
    read = np.ascontiguousarray(model.stored.codes[: 2 * sent[1] - 1, : sent[0]]).reshape(-1)
    return read[: len(read) // 8 * 8].view(np.uint64)
