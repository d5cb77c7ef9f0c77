"""The signatures of a map as int8 codes (docs/decisions/0037-large-maps.md)."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, FloatArray, IntArray, freeze, frozen
from core.encodings.harmonic.in_phase import best_in_phase, whole_codes
from core.encodings.harmonic.stored import StoredSignatures
from core.encodings.harmonics import correlating, weights
from core.errors import InvalidMap
from core.single_flight import single_flight_property

BLOCK_RENDERINGS = 8192
"""Whose codes are decoded at once: one harmonic of them stays in a processor's cache."""

_LARGEST_CODE = 127
_LARGEST_SCALE = 1e10  # a number is at most 1e12


@dataclass(frozen=True, eq=False)
class SignatureCodes(StoredSignatures):
    """Numbers as int8, each rendering's times a scale of its own.

    Ordered by harmonic: a search reads those that were sent, each as one long row. Renderings are
    in the order `(D, K)` there.

    Attributes:
        codes: `(2 r2 - 1, r1, D, K)` int8; the real parts of harmonic 0, then the real and the
            imaginary ones of harmonics 1, 2 ...
        scales: `(K, D)` float32, the number of code 1.
        mixing: `(n, r1)` float32 by which all signatures are multiplied, so that there are n
            radial components; `None` of none.
    """

    codes: NDArray[np.int8]
    scales: Float32Array
    mixing: Float32Array | None = None

    def __post_init__(self) -> None:
        if self.codes.dtype != np.int8 or self.codes.ndim != 4 or not len(self.codes) % 2:
            raise InvalidMap(
                f"signature_codes is {self.codes.dtype} {self.codes.shape}, wanted int8"
                " (2 r2 - 1, r1, renderings, scans)"
            )
        freeze(self, scales=np.float32)
        wanted = self.codes.shape[:1:-1]
        if self.scales.shape != wanted:
            raise InvalidMap(f"rendering_scales has shape {self.scales.shape}, wanted {wanted}")
        if not ((self.scales >= 0.0) & (self.scales <= _LARGEST_SCALE)).all():
            raise InvalidMap(
                f"rendering_scales has numbers that are not within 0..{_LARGEST_SCALE:g}"
            )
        codes = self.codes.view()
        codes.flags.writeable = False
        object.__setattr__(self, "codes", codes)

    @classmethod
    def of(cls, signatures: Complex64Array) -> Self:
        """Round `(K, D, r1, r2)` signatures, whose first column is real."""
        by_harmonic = signatures.transpose(3, 2, 1, 0)
        parts = np.empty((2 * len(by_harmonic) - 1, *by_harmonic.shape[1:]), np.float32)
        parts[0], parts[1::2], parts[2::2] = (
            by_harmonic[0].real,
            by_harmonic[1:].real,
            by_harmonic[1:].imag,
        )
        scales = np.abs(parts).max(axis=(0, 1), initial=0.0) / np.float32(_LARGEST_CODE)
        parts /= np.where(scales > 0.0, scales, np.float32(1.0))
        codes = np.clip(np.rint(parts), -_LARGEST_CODE, _LARGEST_CODE).astype(np.int8)
        return cls(codes, scales.T)

    def joined(self, others: Sequence[StoredSignatures]) -> "SignatureCodes":
        """Return codes one after another, unchanged; numbers are rounded."""
        parts = (self, *(one.as_codes() for one in others))
        return SignatureCodes(
            np.concatenate([part.codes for part in parts], axis=-1),
            np.concatenate([part.scales for part in parts]),
        )

    def as_codes(self) -> "SignatureCodes":
        """Return themselves."""
        return self

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """`(K, D, r1, r2)`."""
        rows, r1, renderings, scans = self.codes.shape
        return scans, renderings, r1 if self.mixing is None else len(self.mixing), rows // 2 + 1

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return both arrays."""
        return {"signature_codes": self.codes, "rendering_scales": self.scales}

    def select(self, rows: IntArray) -> "SignatureCodes":
        """Return those of some scans."""
        return replace(self, codes=self.codes[..., rows], scales=self.scales[rows])

    def limited(self, r1: int) -> "SignatureCodes":
        """Return the first radial components, in the same memory."""
        return replace(self, codes=self.codes[:, :r1])

    def mixed(self, mixing: Float32Array) -> "SignatureCodes":
        """Return signatures with other radial components, in the same memory."""
        return replace(self, mixing=mixing)

    @property
    def numbers(self) -> Complex64Array:
        """All of them, decoded each time."""
        return self.at(np.arange(self.shape[0]))

    def at(self, rows: IntArray, renderings: IntArray | None = None) -> Complex64Array:
        """Decode the signatures of some renderings."""
        if renderings is None:
            codes, scales = self.codes[..., rows].T, self.scales[rows]
        else:
            codes = self.codes[:, :, renderings, rows[:, None]].transpose(2, 3, 1, 0)
            scales = self.scales[rows[:, None], renderings]
        found = np.empty((*codes.shape[:3], codes.shape[3] // 2 + 1), np.complex64)
        parts = found.view(np.float32)  # a real and an imaginary part of each, as codes have them
        parts[..., 0], parts[..., 1], parts[..., 2:] = codes[..., 0], 0.0, codes[..., 1:]
        parts *= scales[..., None, None]
        return found if self.mixing is None else np.asarray(self.mixing @ found)

    def waves(self, query: Complex64Array, block: slice) -> Float32Array:
        """Return sum_r q_rm conj(G_rm) of some renderings, `(m, 2, n)`: real and imaginary parts.

        Args:
            query: `(r1, m)`, m up to r2.
            block: Which renderings, in the order `(D, K)`.
        """
        waves = waves_of(self._by_rendering[..., block], self._of_components(query))
        waves *= self._scale_of[block]
        return waves

    def best_in_phase(self, query: Complex64Array, factor: Float32Array) -> Float32Array:
        """Return the largest sum of magnitudes of `waves` of each scan's renderings, `(K,)`.

        Args:
            query: `(r1, m)`, m up to r2.
            factor: `(D, K)` by which each rendering's codes are multiplied, not negative.
        """
        return best_in_phase(self._read, self._of_components(query), factor)

    @single_flight_property
    def _read(self) -> NDArray[np.int8]:
        """The codes as they are read the fastest."""
        whole = whole_codes(self.codes)
        return self.codes if whole is None else whole

    def _of_components(self, query: Complex64Array) -> Complex64Array:
        """Return what multiplies codes, of what multiplies signatures."""
        return query if self.mixing is None else (self.mixing.T @ query).astype(np.complex64)

    def squared_norms(self, columns: int, harmonics: int) -> FloatArray:
        """Return |G|^2 of the first harmonics of every rendering, `(K, D)`."""
        weight = np.repeat(weights(columns, harmonics), 2)[1:]
        squared = np.empty(len(self._scale_of))
        for block in blocks_of(len(squared)):
            numbers = self._by_rendering[: len(weight), :, block].astype(np.float32)
            if self.mixing is not None:
                numbers = self.mixing @ numbers
            np.square(numbers, out=numbers)
            squared[block] = weight @ numbers.sum(axis=1, dtype=np.float64)
        squared *= np.square(self._scale_of, dtype=np.float64)
        return squared.reshape(self.scales.shape[::-1]).T

    @single_flight_property
    def _by_rendering(self) -> NDArray[np.int8]:
        return self.codes.reshape(*self.codes.shape[:2], -1)

    @single_flight_property
    def _scale_of(self) -> Float32Array:
        return frozen(self.scales.T.reshape(-1), np.float32)


def waves_of(codes: NDArray[np.int8], query: Complex64Array) -> Float32Array:
    """Return sum_r q_rm conj(C_rm) of `(2 r2 - 1, r1, n)` codes, `(m, 2, n)`, m up to r2."""
    waves = np.empty((query.shape[1], 2, codes.shape[-1]), np.float32)
    for harmonic, factor in enumerate(correlating(query)):
        parts = codes[max(0, 2 * harmonic - 1) : 2 * harmonic + 1]
        numbers = parts.astype(np.float32).reshape(-1, codes.shape[-1])
        np.matmul(factor[:, : len(numbers)], numbers, out=waves[harmonic])
    return waves


def blocks_of(renderings: int) -> list[slice]:
    """Return slices of so many renderings.

    Examples:
        >>> blocks_of(10_000)
        [slice(0, 8192, None), slice(8192, 10000, None)]
    """
    starts = [*range(0, renderings, BLOCK_RENDERINGS), renderings]
    return [slice(start, end) for start, end in itertools.pairwise(starts)]
