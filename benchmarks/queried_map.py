"""A map of 3,800 simulated scans with queries to it, kept in a file for the next run."""

import hashlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import core
from benchmarks.maps import localizer_of
from core.encodings.signature import pack_signatures
from core.localization.localizer import Localizer
from core.parameters import MapParameters
from core.projection.imager import Views
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.files.files import publish
from storage.files.map_file import read_map, write_map

ANY_VIEWS = MapParameters.for_sensor(encoding="harmonic")
FULL_VIEWS = MapParameters.for_sensor(encoding="harmonic", views=Views.FULL)
SCANS, QUERIES, WAY, RETURNS = 3800, 32, 60, 60_000
_LOOP_M = 1.05 * SCANS
_QUERY_SEED, _LATERAL_M = 7, 0.7


@dataclass(frozen=True)
class QueriedMap:
    """A calibrated map with poses, and packed signatures of scans near its line.

    Attributes:
        path: The file's path.
        localizer: The map's localizer.
        bodies: The queries, `QUERIES` of them, from all over the map.
        way: Those of a vehicle on its way, `WAY` of them, one scan of the map after another.
    """

    path: Path
    localizer: Localizer
    bodies: tuple[bytes, ...]
    way: tuple[bytes, ...]


def queried_map(parameters: MapParameters) -> QueriedMap:
    """Return the map, built or read, and its queries."""
    named = hashlib.sha256(repr((parameters, SCANS, _code())).encode()).hexdigest()[:12]
    path = Path(tempfile.gettempdir(), f"tensormap-benchmark-{named}.h5")
    if path.exists():
        localizer = Localizer(read_map(path))
    else:
        mapped = _drive(firings=180)
        localizer = localizer_of(mapped, np.arange(SCANS), parameters, segments=5, calibrated=True)
        with publish(path) as part:  # another benchmark may make it too
            write_map(part, localizer.map)
    beside, basis = _drive(180, _QUERY_SEED, _LATERAL_M), localizer.basis
    bodies, way = (
        tuple(pack_signatures(basis.encode(basis.image(beside.scan(index)))) for index in rows)
        for rows in (
            np.linspace(3, SCANS - 3, QUERIES).astype(int).tolist(),
            range(SCANS // 2, SCANS // 2 + WAY),
        )
    )
    return QueriedMap(path, localizer, bodies, way)


def _code() -> str:
    """Return a digest of what makes the map: one that older code made has other figures."""
    sources = sorted(Path(core.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


def large_scan() -> bytes:
    """Return a scan of `RETURNS` in KITTI's layout, recorded in the map."""
    points = np.resize(_dense_scan().points_m, (RETURNS, 3))
    return bytes(np.pad(points, ((0, 0), (0, 1))).astype("<f4").tobytes())


def _dense_scan() -> Scan:
    return _drive(1800, _QUERY_SEED).scan(5)


def _drive(firings: int, noise_seed: int = 0, lateral_offset_m: float = 0.0) -> SimulatedDrive:
    return SimulatedDrive(
        seed=1,
        scans=SCANS,
        loop_m=_LOOP_M,
        sensor=SimulatedSensor(firings=firings),
        noise_seed=noise_seed,
        lateral_offset_m=lateral_offset_m,
    )
