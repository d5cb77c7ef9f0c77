"""Scan Context (Kim and Kim, IROS 2018): the highest return of each polar cell around the sensor.

Re-derived from the paper's equations 1 to 8. What it leaves open, and what is done here: heights
are above ground, z + `sensor_height_m`, clipped at 0, so that 0 means empty as in the paper; the
cosine of an empty column is not defined, so that the mean is over the columns in which both
descriptors are not empty; without any, the distance is 1.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from baselines.descriptor import PlaceDescriptor, Places, relative_yaw_deg
from core.arrays import Complex64Array, Float32Array, FloatArray, IntArray
from core.errors import InvalidScan
from core.evaluation.methods import Nearest
from core.numbers import require_above, require_at_least
from core.scans.scan import Scan


@dataclass(frozen=True)
class ScanContext(PlaceDescriptor):
    """The descriptor, with the paper's parameters as defaults.

    Attributes:
        rings: N_r.
        sectors: N_s.
        reach_m: L_max; returns beyond it are left out.
        sensor_height_m: The sensor's height above ground.
        candidates: How many places, nearest by their ring key, are compared with the query; `None`
            compares all of them (brute force). The paper's are 10 and 50.

    Examples:
        >>> wall = Scan(np.array([[0.0, 10.0, 0.5], [0.0, 11.0, 1.5]]))
        >>> context = ScanContext(sensor_height_m=2.0).describe(wall)
        >>> context.shape, float(context[2, 15])
        ((20, 60), 3.5)
    """

    rings: int = 20
    sectors: int = 60
    reach_m: float = 80.0
    sensor_height_m: float = 1.73
    candidates: int | None = None

    def __post_init__(self) -> None:
        require_at_least(1, rings=self.rings, sectors=self.sectors, candidates=self.candidates)
        require_above(0, reach_m=self.reach_m)
        require_above(-math.inf, sensor_height_m=self.sensor_height_m)

    @property
    def name(self) -> str:
        """`scan-context`, with the number of candidates if it is limited."""
        return "scan-context" + ("" if self.candidates is None else "-ring-key")

    @property
    def shape(self) -> tuple[int, ...]:
        """`(N_r, N_s)`."""
        return self.rings, self.sectors

    def describe(self, scan: Scan) -> Float32Array:
        """Return the greatest height of each ring and sector in metres, 0 where nothing is.

        Raises:
            InvalidScan: If no return within reach is above the ground.
        """
        x, y, z = scan.points_m.T.astype(np.float64)
        ring = np.floor(np.sqrt(x * x + y * y) * (self.rings / self.reach_m))
        inside = ring < self.rings
        azimuth = np.arctan2(y[inside], x[inside]) / (2.0 * np.pi) % 1.0
        sector = np.floor(azimuth * self.sectors).astype(np.int64) % self.sectors
        cells = ring[inside].astype(np.int64) * self.sectors + sector
        heights_m = (z[inside] + self.sensor_height_m).astype(np.float32)
        context = np.zeros(self.rings * self.sectors, np.float32)
        np.maximum.at(context, cells, heights_m)
        if not context.any():
            raise InvalidScan(
                f"none of the {len(scan)} returns is above the ground within {self.reach_m:g} m"
            )
        return context.reshape(self.shape)

    def places(self, descriptors: Float32Array) -> Places:
        """Return places to search."""
        return ScanContextPlaces(descriptors, self.candidates)


def ring_keys(contexts: Float32Array) -> FloatArray:
    """Return the share of each ring's sectors that are not empty, `(..., N_r)`: equation 7."""
    return np.asarray(np.count_nonzero(contexts, axis=-1) / contexts.shape[-1])


class ScanContextPlaces(Places):
    """Scan Contexts compared column by column, in every shift.

    The sum over columns j of cos(q_j, c_{j+s}) is a circular correlation of unit columns, and so is
    the number of columns that neither has empty: Fourier transforms give both for all shifts s.
    """

    def __init__(self, contexts: Float32Array, candidates: int | None) -> None:
        self._sectors = contexts.shape[-1]
        self._candidates = candidates
        super().__init__(contexts)
        self._spectra, self._filled = _spectra(contexts)
        keys = ring_keys(contexts)
        self._tree = cKDTree(keys) if candidates is not None and len(keys) else None
        if candidates is not None:
            self.stored_bytes += keys.astype(np.float32).nbytes

    def _nearest(self, descriptor: Float32Array, last: int) -> Nearest:
        """Return the place at the least distance in its best shift, equations 5 and 6."""
        rows = None if self._tree is None else self._candidate_rows(descriptor, last)
        distances = self.distances(descriptor, slice(last) if rows is None else rows)
        best, shift = np.unravel_index(int(distances.argmin()), distances.shape)
        return Nearest(
            int(best if rows is None else rows[best]),
            max(0.0, float(distances[best, shift])),
            relative_yaw_deg(int(shift), self._sectors),
        )

    def distances(self, descriptor: Float32Array, rows: IntArray | slice) -> Float32Array:
        """Return the distance to some places in every shift, `(n, N_s)`.

        In shift s sector j of the query lies on sector j + s of the place.
        """
        spectrum, filled = _spectra(descriptor[None])
        products = (self._spectra[:, rows] @ np.conj(spectrum[:, 0, :, None]))[..., 0]
        shared = self._filled[:, rows] * np.conj(filled)
        cosines = np.fft.irfft(products, self._sectors, axis=0)
        columns = np.rint(np.fft.irfft(shared, self._sectors, axis=0))
        mean = np.divide(cosines, columns, out=np.zeros_like(cosines), where=columns > 0)
        return np.asarray(1.0 - mean.T, dtype=np.float32)

    def _candidate_rows(self, descriptor: Float32Array, last: int) -> IntArray:
        """Return the rows below `last` whose ring keys are nearest, rising."""
        assert self._tree is not None  # noqa: S101 - for mypy
        assert self._candidates is not None  # noqa: S101 - for mypy
        needed = k = min(self._candidates, last)
        key = ring_keys(descriptor)
        while True:  # until enough of the nearest rows are below `last`
            found = np.atleast_1d(self._tree.query(key, k=k)[1])
            allowed = found[found < last]
            if len(allowed) >= needed or k >= len(self):
                return np.sort(allowed[:needed])
            k = min(2 * k, len(self))


def _spectra(contexts: Float32Array) -> tuple[Complex64Array, Complex64Array]:
    """Return transforms over the sectors: of unit columns `(F, K, N_r)` and of filled ones."""
    norms = np.linalg.norm(contexts, axis=-2)
    filled = norms > 0
    unit = contexts / np.where(filled, norms, 1.0)[..., None, :]
    of_columns = np.fft.rfft(unit, axis=-1).transpose(2, 0, 1)
    of_filled = np.fft.rfft(filled.astype(np.float64), axis=-1).T
    return (
        np.ascontiguousarray(of_columns, dtype=np.complex64),
        np.ascontiguousarray(of_filled, dtype=np.complex64),
    )
