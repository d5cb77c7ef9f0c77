"""The harmonic encoding: one radial basis for the whole map, circular harmonics in azimuth.

A turn of the sensor moves the columns of an image around, which leaves S S^T as it is, and with it
U, and multiplies harmonic m by a phase. So a signature made in any heading is compared with the
map's in every heading, and the best one tells how far the vehicle is turned.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import (
    BoolArray,
    Complex64Array,
    ComplexArray,
    Float32Array,
    FloatArray,
    IntArray,
    frozen,
)
from core.encodings.base import Found, Segmented, nearest, require_sane
from core.encodings.signature import Signature
from core.errors import InvalidMap, InvalidSignature
from core.parameters import Distance
from core.scans.angles import wrapped_deg

__all__ = [
    "HarmonicModel",
    "HarmonicSearch",
    "azimuth_factor",
    "encode",
    "energy",
    "harmonic_elements",
    "weights",
]

_SAMPLES_A_WAVE = 12  # of the shortest wave: the parabola then errs by less than 0.1 deg
_FIRST = 4  # scans that are searched before the bound decides on the others
_EXACT_SCANS = 1024  # searched over headings at once: 10 MB of them
_SLACK = 1e-5  # of the bound, in single precision, as a share of |g| |G|: ten times its rounding
_ROUNDING = 1e-12  # of sums in double precision


def azimuth_factor(columns: int, r2: int) -> ComplexArray:
    """Return the first `r2` circular harmonics, f_m(j) = exp(-2 pi i m j / J) / sqrt(J), `(J, r2)`.

    Examples:
        >>> factor = azimuth_factor(8, 3)
        >>> bool(np.allclose(factor.conj().T @ factor, np.eye(3)))
        True
    """
    # The product is reduced mod J while it is whole, and f_0 and f_{J/2} are real to the bit.
    turns = np.outer(np.arange(columns), np.arange(r2)) % columns / columns
    factor = np.exp(-2j * np.pi * turns)
    factor.imag[2 * turns % 1 == 0] = 0.0
    return np.asarray(factor / np.sqrt(columns))


def weights(columns: int, r2: int) -> FloatArray:
    """Return w_m, `(r2,)`: a harmonic stands for its conjugate too, but 0 and J/2 have none.

    With them |G|^2 = sum_m w_m sum_r |G_rm|^2 is the energy that the encoding keeps of an image.

    Examples:
        >>> weights(8, 5).tolist()
        [1.0, 2.0, 2.0, 2.0, 1.0]
    """
    harmonic = np.arange(r2)
    return np.where((harmonic == 0) | (2 * harmonic == columns), 1.0, 2.0)


def harmonic_elements(scans: int, renderings: int, rows: int, ranks: tuple[int, int]) -> int:
    """Return I r1 + D + K D r1 (2 r2 - 1): a complex number is two, the first column real.

    Examples:
        >>> harmonic_elements(scans=3800, renderings=5, rows=20, ranks=(5, 5))
        855105
    """
    r1, r2 = ranks
    return rows * r1 + renderings + scans * renderings * r1 * (2 * r2 - 1)


def encode(
    images: Float32Array | FloatArray, u: Float32Array | FloatArray, r2: int
) -> ComplexArray:
    """Return G = U^T S F of `(..., I, J)` images, `(..., r1, r2)`; the first column is real."""
    factor = azimuth_factor(images.shape[-1], r2)
    radial = u.astype(np.float64).T @ images.astype(np.float64)
    return np.asarray(radial @ factor.real + 1j * (radial @ factor.imag))


def energy(signatures: NDArray[np.complexfloating[Any, Any]], columns: int) -> FloatArray:
    """Return |G|^2 in the weighted norm of `(..., r1, r2)` signatures, `(...)`."""
    squared = np.square(signatures.real, dtype=np.float64)
    squared += np.square(signatures.imag, dtype=np.float64)
    return np.asarray(squared.sum(axis=-2) @ weights(columns, signatures.shape[-1]))


@dataclass(frozen=True, eq=False)
class HarmonicModel(Segmented):
    """All scans' signatures in one basis, each from several places beside the line.

    Attributes:
        radial_basis: `(I, r1)` float32, orthonormal columns; U of all segments.
        signatures: `(K, D, r1, r2)` complex64, the first column real; D renderings of each scan.
        lateral_offset_m: `(D,)` how far to the left of the line each rendering is seen from.
        segment_start: `(L + 1,)` row of each segment's first scan, and K.
        columns: J, how many azimuths an image has.
        measure: How signatures are compared.
    """

    radial_basis: Float32Array
    signatures: Complex64Array
    lateral_offset_m: FloatArray
    segment_start: IntArray
    columns: int
    measure: Distance

    def __post_init__(self) -> None:
        for name, dtype in (
            ("radial_basis", np.float32),
            ("signatures", np.complex64),
            ("lateral_offset_m", np.float64),
            ("segment_start", np.int64),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), dtype))
        if self.radial_basis.ndim != 2 or self.signatures.ndim != 4:
            raise InvalidMap("the radial basis has two axes, signatures have four")
        scans, renderings, r1, r2 = self.signatures.shape
        if self.radial_basis.shape[1] != r1 or self.lateral_offset_m.shape != (renderings,):
            raise InvalidMap(
                f"radial_basis {self.radial_basis.shape}, signatures {self.signatures.shape} and"
                f" lateral_offset_m {self.lateral_offset_m.shape} do not fit together"
            )
        if not 1 <= r2 <= self.columns // 2 + 1 or r1 < 1:
            raise InvalidMap(f"signatures have {r2} harmonics of {self.columns} columns")
        self._require_rising(scans)
        require_sane({"radial_basis": self.radial_basis}, self.signatures)
        if not np.isfinite(self.lateral_offset_m).all():
            raise InvalidMap("lateral_offset_m holds numbers that are not finite")
        if self.signatures[..., 0].imag.any():
            raise InvalidMap("the first column of a harmonic signature is real")

    @property
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""
        return self.signatures.shape[2], self.signatures.shape[3]

    @property
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""
        return self.radial_basis.shape[0], self.columns

    @property
    def elements(self) -> int:
        """How many numbers the basis and signatures are."""
        scans, renderings = self.signatures.shape[:2]
        return harmonic_elements(scans, renderings, self.grid_shape[0], self.ranks)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file."""
        return {
            "radial_basis": self.radial_basis,
            "signatures": self.signatures,
            "lateral_offset_m": self.lateral_offset_m,
            "segment_start": self.segment_start,
        }

    def search(self, signatures: Sequence[Signature]) -> "HarmonicSearch":
        """Compare one scan's signature with the map's in every heading.

        Raises:
            InvalidSignature: If it is the paper's, or there are several.
        """
        if len(signatures) != 1 or signatures[0].segment is not None:
            raise InvalidSignature(
                "a harmonic map is asked with one harmonic signature, of no segment"
            )
        return HarmonicSearch(self, signatures[0].values.astype(np.complex128))

    @cached_property
    def norms(self) -> FloatArray:
        """|G| of every rendering, `(K, D)`."""
        return np.sqrt(energy(self.signatures, self.columns))

    @cached_property
    def units(self) -> Complex64Array:
        """Conjugate signatures of norm 1, weighted by sqrt(w_m), `(r2, r1, D K)`.

        Harmonic by harmonic, rendering by rendering, and each row contiguous: the bound is then r2
        products with long vectors and the greatest of D of them.
        """
        scaled = np.conj(self.signatures.astype(np.complex128))
        scaled *= np.sqrt(weights(self.columns, self.ranks[1]))
        scaled /= np.where(self.norms > 0, self.norms, 1.0)[..., None, None]
        r1, r2 = self.ranks
        by_harmonic: Complex64Array = frozen(
            scaled.transpose(3, 2, 1, 0).reshape(r2, r1, -1), np.complex64
        )
        return by_harmonic


class HarmonicSearch:
    """One harmonic signature, compared with every rendering of every scan.

    The correlation over headings s is max_s Re sum_m w_m e^(2 pi i m s / J) c_m with
    c_m = sum_r g_rm conj(G_rm), and never more than sum_m w_m |c_m|. That bound costs little and
    leaves few renderings whose headings have to be searched; the answer is the same as if all had.
    """

    def __init__(self, model: HarmonicModel, values: ComplexArray) -> None:
        self._model = model
        self._values = values
        self._weights = weights(model.columns, model.ranks[1])
        self._norm = float(np.sqrt(energy(values, model.columns)))

    @property
    def segments(self) -> tuple[int, ...]:
        """All of them: the basis is shared."""
        return tuple(range(self._model.segments))

    @property
    def lateral_offset_m(self) -> FloatArray:
        """How far to the left of the line each rendering is seen from, `(D,)`."""
        return self._model.lateral_offset_m

    def nearest(self, k: int, among: BoolArray | None = None) -> tuple[Found, ...]:
        """Return the `k` nearest scans, each by its nearest rendering, nearest first."""
        lower = self._lower_bounds if among is None else self._lower_bounds[among]
        if not len(lower):
            return ()
        rows = np.arange(len(self._model)) if among is None else np.flatnonzero(among)
        first = nearest(lower, max(k, _FIRST))
        distances, turn_deg = self.exact(rows[first])
        reached = nearest(distances.min(axis=1), k)
        left = lower <= distances.min(axis=1)[reached[-1]]
        left[first] = False
        searched = rows[first]
        if left.any():
            more = self.exact(rows[left])
            searched = np.concatenate([searched, rows[left]])
            distances = np.concatenate([distances, more[0]])
            turn_deg = np.concatenate([turn_deg, more[1]])
        in_order = np.argsort(searched)
        return self._ranked(searched[in_order], distances[in_order], turn_deg[in_order], k)

    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return the distance of each scan's nearest rendering, `(K,)`, infinite if not asked."""
        distances = np.full(len(self._model), np.inf)
        rows = np.arange(len(distances)) if among is None else np.flatnonzero(among)
        for start in range(0, len(rows), _EXACT_SCANS):
            block = rows[start : start + _EXACT_SCANS]
            distances[block] = self.exact(block)[0].min(axis=1)
        return distances

    def nearest_by_brute_force(self, k: int) -> tuple[Found, ...]:
        """Return what `nearest` does, having searched the headings of every rendering."""
        rows = np.arange(len(self._model))
        return self._ranked(rows, *self.exact(rows), k)

    def _ranked(
        self, rows: IntArray, distances: FloatArray, turn_deg: FloatArray, k: int
    ) -> tuple[Found, ...]:
        rendering = distances.argmin(axis=1)
        by_scan = distances.min(axis=1)
        turns_told = self._model.ranks[1] > 1
        return tuple(
            Found(
                row=int(rows[i]),
                distance=float(by_scan[i]),
                turn_deg=float(turn_deg[i, rendering[i]]) if turns_told else None,
                lateral_m=float(self._model.lateral_offset_m[rendering[i]]),
            )
            for i in nearest(by_scan, k).tolist()
        )

    @cached_property
    def _lower_bounds(self) -> FloatArray:
        """Below which the distance of none of a scan's renderings can be, `(K,)`."""
        model = self._model
        unit = (self._values / (self._norm or 1.0) * np.sqrt(self._weights)).astype(np.complex64)
        correlation = np.zeros(model.norms.size, np.float32)
        for of_query, of_map in zip(unit.T, model.units, strict=True):
            product = of_query @ of_map
            squared = product.real**2
            squared += product.imag**2
            correlation += np.sqrt(squared, out=squared)
        norms = model.norms.T
        share = correlation.reshape(norms.shape)
        if model.measure == Distance.NORMALISED:
            return np.asarray(1.0 - (share.max(axis=0).astype(np.float64) + _SLACK))
        at_most = (share.astype(np.float64) + _SLACK) * (self._norm * norms)
        plain: FloatArray = self._plain(at_most, norms).min(axis=0)
        return plain * (1.0 - _ROUNDING)

    def exact(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Search the headings of all renderings of some scans.

        Every step is rounded by itself and the same for one scan as for all.

        Returns:
            Distances and turns in degrees, counter-clockwise from the map's scan, `(n, D)` each.
        """
        model = self._model
        stored = model.signatures[rows]
        real, imag = stored.real.astype(np.float64), stored.imag.astype(np.float64)
        g = self._values
        c_real = (g.real * real + g.imag * imag).sum(axis=2)
        c_imag = (g.imag * real - g.real * imag).sum(axis=2)
        at_most = (np.sqrt(c_real * c_real + c_imag * c_imag) * self._weights).sum(axis=-1)
        # irfft sums conjugate pairs by itself: w = 2, and half of that where there is no pair.
        r2 = model.ranks[1]
        pairs = np.where(np.arange(r2) > 0, self._weights / 2.0, 1.0)
        samples = max(8, 1 << (_SAMPLES_A_WAVE * r2 - 1).bit_length())
        correlation = np.fft.irfft((c_real + 1j * c_imag) * pairs, samples, axis=-1) * samples
        peak = correlation.argmax(axis=-1)
        # Indices by hand: `take_along_axis` costs as much as all the rest for a few scans.
        waves = correlation.reshape(-1)
        begin = np.arange(0, len(waves), samples).reshape(peak.shape)
        before, at, after = (waves[begin + (peak + step) % samples] for step in (-1, 0, 1))
        curvature = 2.0 * at - before - after
        curved = curvature > 0.0
        slope = after - before
        safe = np.where(curved, curvature, 1.0)
        offset = np.where(curved, 0.5 * slope / safe, 0.0)
        best = np.where(curved, at + slope * slope / (8.0 * safe), at)
        turn_deg = -(peak + offset) * (360.0 / samples)
        return self._distance(np.minimum(best, at_most), rows), wrapped_deg(turn_deg)

    def _distance(self, correlation: FloatArray, rows: IntArray) -> FloatArray:
        norms = self._model.norms[rows]
        if self._model.measure == Distance.PLAIN:
            return self._plain(correlation, norms)
        both = self._norm * norms
        share = np.divide(correlation, both, out=np.zeros_like(both), where=both > 0)
        return np.maximum(1.0 - share, 0.0)

    def _plain(self, correlation: FloatArray, norms: FloatArray) -> FloatArray:
        return np.maximum(self._norm * self._norm + norms * norms - 2.0 * correlation, 0.0)
