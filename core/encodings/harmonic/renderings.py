"""The renderings of a map as a search compares them: their signatures, norms and energies."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from core.arrays import Complex64Array, Float32Array, FloatArray, IntArray, frozen
from core.encodings.harmonic.codes import SignatureCodes, blocks_of
from core.encodings.harmonic.in_phase import in_phase
from core.encodings.harmonic.stored import StoredSignatures
from core.encodings.harmonics import as_real, circular_energy, correlating, energy, root_weights
from core.single_flight import SingleFlight, single_flight_property, weakly

ESTIMATED_WAVES = 6
"""How many waves of energies, and of what a rendering sees, estimates take."""

LEAST_SEEN = np.float32(0.02)
"""Floor of the share of a rendering's energy that is seen: with less, everything is alike."""

_KEPT = 4  # numbers of sent harmonics
_DECODED_SCANS = 1024  # at once, in 5 MB
_MOST_DECODED = 20_000  # renderings whose codes are kept as numbers too, in 40 MB


class Renderings(ABC):
    """All renderings of a map, in the order `(D, K)` where they are one long row.

    Attributes:
        is_large: Whether there are so many that none are kept decoded.
        blocks: Slices of the row that are compared at once.
    """

    is_large: bool
    blocks: list[slice]

    def __init__(self, shape: tuple[int, int, int, int], columns: int) -> None:
        self._scans, self._columns, self._harmonics = shape[0], columns, shape[3]

    @property
    @abstractmethod
    def numbers(self) -> Complex64Array:
        """All signatures, `(K, D, r1, r2)`; of a large map decoded each time."""

    @abstractmethod
    def at(self, rows: IntArray, renderings: IntArray | None = None) -> Complex64Array:
        """Return the signatures of some renderings, as `StoredSignatures.at`."""

    @property
    @abstractmethod
    def norms(self) -> FloatArray:
        """|G| of every rendering, `(K, D)`."""

    @abstractmethod
    def waves(self, query: Complex64Array, block: slice) -> Float32Array:
        """Return the correlation of each harmonic with some renderings of norm 1.

        As real and imaginary parts, `(m, 2, n)`.

        Args:
            query: `(r1, m)`, m up to r2; weighted by sqrt(w_m).
            block: One of `blocks`.
        """

    @abstractmethod
    def best_in_phase(self, query: Complex64Array, r2: int | None = None) -> Float32Array:
        """Return what each scan's best rendering of norm 1 has with all waves in phase, `(K,)`.

        Args:
            query: `(r1, m)`, m up to r2; weighted by sqrt(w_m).
            r2: The number of harmonics that the norm is of, all by default; then at least
                `LEAST_SEEN`.
        """

    @abstractmethod
    def energy_share(self, r2: int) -> Float32Array:
        """Return the share of the energy of all harmonics that the first r2 have, `(D K,)`."""

    @single_flight_property
    def unit_energies(self) -> Callable[[int], Float32Array]:
        """Where on the circle the energy of the first r2 harmonics is, `(2 n - 1, D K)`, of r2.

        As a share of the energy of all that are kept: at most 1 in row 0.
        """
        return SingleFlight(weakly(self._unit_energies), _KEPT)

    def _unit_energies(self, r2: int) -> Float32Array:
        count = 2 * min(ESTIMATED_WAVES, 2 * r2 - 1) - 1
        found = np.empty((count, *self.norms.shape[::-1]), np.float32)
        for start in range(0, self._scans, _DECODED_SCANS):
            rows = np.arange(start, min(start + _DECODED_SCANS, self._scans))
            energies = circular_energy(self.at(rows)[..., :r2], ESTIMATED_WAVES)
            norms = self.norms[rows]
            energies /= np.where(norms > 0, np.square(norms), 1.0)[..., None]
            found[..., rows] = as_real(energies.transpose(2, 1, 0))
        return frozen(found.reshape(count, -1), np.float32)


class DecodedRenderings(Renderings):
    """Renderings of a small map, whose signatures are kept as numbers."""

    is_large = False

    def __init__(self, stored: StoredSignatures, columns: int) -> None:
        super().__init__(stored.shape, columns)
        self._stored = stored
        self.blocks = [slice(0, stored.shape[0] * stored.shape[1])]

    @single_flight_property
    def numbers(self) -> Complex64Array:
        """All signatures, kept."""
        return frozen(self._stored.numbers, np.complex64)

    def at(self, rows: IntArray, renderings: IntArray | None = None) -> Complex64Array:
        """Return the signatures of some renderings."""
        return self.numbers[rows] if renderings is None else self.numbers[rows[:, None], renderings]

    @single_flight_property
    def norms(self) -> FloatArray:
        """|G| of every rendering."""
        return np.sqrt(energy(self.numbers, self._columns))

    def waves(self, query: Complex64Array, block: slice) -> Float32Array:
        """Return the products with `_units`; there is one block."""
        return np.asarray(correlating(query) @ self._units[: query.shape[1]])

    def best_in_phase(self, query: Complex64Array, r2: int | None = None) -> Float32Array:
        """Return the most of each scan, of its waves."""
        (whole,) = self.blocks
        found = in_phase(self.waves(query, whole))
        if r2 is not None:
            found *= self._inverse_seen(r2)
        return np.asarray(found.reshape(-1, self._scans).max(axis=0))

    @single_flight_property
    def _inverse_seen(self) -> Callable[[int], Float32Array]:
        return SingleFlight(weakly(self._inverse_seen_of), _KEPT)

    def _inverse_seen_of(self, r2: int) -> Float32Array:
        return np.asarray(1.0 / np.sqrt(self.energy_share(r2) + LEAST_SEEN))

    def energy_share(self, r2: int) -> Float32Array:
        """Return the share of the first r2 harmonics."""
        return np.asarray(self.unit_energies(r2)[0])

    @single_flight_property
    def _units(self) -> Float32Array:
        """Parts of signatures of norm 1, weighted by sqrt(w_m), `(r2, 2 r1, D K)`.

        Ordered by harmonic, then by rendering, each row contiguous: the waves are then r2 products
        of a small matrix with a long one, of real numbers, which read memory the fastest.
        """
        scaled = self.numbers.astype(np.complex128)
        scaled *= root_weights(self._columns, self._harmonics)
        scaled /= np.where(self.norms > 0, self.norms, 1.0)[..., None, None]
        parts = np.concatenate([scaled.real, scaled.imag], axis=2)
        return frozen(parts.transpose(3, 2, 1, 0).reshape(*parts.shape[:1:-1], -1), np.float32)


class CodedRenderings(Renderings):
    """Renderings of a large map, or within some rings, decoded block after block for each query."""

    def __init__(self, codes: SignatureCodes, columns: int) -> None:
        super().__init__(codes.shape, columns)
        self.is_large = codes.scales.size > _MOST_DECODED
        self._codes = codes
        self.blocks = blocks_of(codes.scales.size)
        self._energy_shares = SingleFlight(weakly(self._energy_share), _KEPT)
        self._factors = SingleFlight(weakly(self._factor), _KEPT)

    def best_in_phase(self, query: Complex64Array, r2: int | None = None) -> Float32Array:
        """Return the most of each scan, read from its codes."""
        return self._codes.best_in_phase(self._weighted(query), self._factors(r2))

    def _weighted(self, query: Complex64Array) -> Complex64Array:
        roots = root_weights(self._columns, query.shape[1])
        return np.asarray(query * roots.astype(np.float32))

    def _factor(self, r2: int | None) -> Float32Array:
        """What makes sums of codes those of numbers of renderings of norm 1, `(D, K)`."""
        factor = self._codes.scales.T.reshape(-1) * self._inverse_norms
        if r2 is not None:
            factor /= np.sqrt(self.energy_share(r2) + LEAST_SEEN)
        return frozen(factor.reshape(self.norms.shape[::-1]), np.float32)

    @property
    def numbers(self) -> Complex64Array:
        """All signatures, decoded."""
        return self._codes.numbers

    def at(self, rows: IntArray, renderings: IntArray | None = None) -> Complex64Array:
        """Decode the signatures of some renderings."""
        return self._codes.at(rows, renderings)

    @single_flight_property
    def norms(self) -> FloatArray:
        """|G| of every rendering."""
        return np.sqrt(self._codes.squared_norms(self._columns, self._harmonics))

    def waves(self, query: Complex64Array, block: slice) -> Float32Array:
        """Return the products with codes, divided by the norms."""
        waves = self._codes.waves(self._weighted(query), block)
        waves *= self._inverse_norms[block]
        return waves

    def energy_share(self, r2: int) -> Float32Array:
        """Return the share of the first r2 harmonics."""
        return self._energy_shares(r2)

    def _energy_share(self, r2: int) -> Float32Array:
        squared = self._codes.squared_norms(self._columns, r2).T.reshape(-1)
        return frozen(squared * np.square(self._inverse_norms, dtype=np.float64), np.float32)

    @single_flight_property
    def _inverse_norms(self) -> Float32Array:
        norms = self.norms.T.reshape(-1)
        return frozen(1.0 / np.where(norms > 0, norms, 1.0), np.float32)


def renderings_of(stored: StoredSignatures, columns: int) -> Renderings:
    """Return the renderings of stored signatures, kept decoded unless they are many codes.

    Codes that a matrix multiplies are not: there may be as many matrices as rings.
    """
    if isinstance(stored, SignatureCodes) and (
        stored.scales.size > _MOST_DECODED or stored.mixing is not None
    ):
        return CodedRenderings(stored, columns)
    return DecodedRenderings(stored, columns)
