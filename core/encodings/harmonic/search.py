"""One harmonic signature, compared with every rendering of every scan."""

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from core.arrays import (
    BoolArray,
    Complex64Array,
    ComplexArray,
    Float32Array,
    FloatArray,
    IntArray,
    frozen,
)
from core.encodings.distance import Distance
from core.encodings.harmonic.in_phase import in_phase
from core.encodings.harmonics import energy, root_weights, weights
from core.encodings.search import Neighbours, Search, Viewpoints, nearest
from core.scans.angles import wrapped_deg

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel

_SAMPLES_A_WAVE = 12  # of the shortest wave: the parabola then errs by less than 0.1 deg
_MOST_STEP_DEG = 4.0  # between headings of an estimate: of few harmonics, those of a mask count
FIRST = 4  # scans that are searched before the bound excludes others
_AT_ONCE = 64  # of those that are left
SLACK = 1e-5  # of the bound, in single precision, as a share of |g| |G|: ten times its rounding
_HEADINGS_ONCE = 1024  # renderings, in the processor's cache
_ROUNDING = 1e-12  # of sums in double precision
_BESIDE = np.array([[[-1]], [[0]], [[1]]])  # the heading before a peak, its own, the one after


class HarmonicSearch(Search):
    """One harmonic signature, compared with every rendering of every scan.

    The correlation over headings s is max_s Re sum_m w_m e^(2 pi i m s / J) c_m with
    c_m = sum_r g_rm conj(G_rm), and never more than sum_m w_m |c_m|. That bound costs little and
    leaves few renderings whose headings have to be searched; the result is that of searching all.
    """

    block_scans: ClassVar[int] = 1024  # compared at once, in 10 MB

    def __init__(self, model: "HarmonicModel", values: ComplexArray) -> None:
        self._model = model
        self._values = values
        self._roots = root_weights(model.columns, model.ranks[1])
        self._norm = math.sqrt(energy(values, model.columns))
        self.segments = tuple(range(model.segments))  # all of them: the basis is shared
        self._place_of_row: dict[int, int] = {}  # in `_compared`
        none = np.empty((0, len(model.lateral_offset_m)))
        self._compared: tuple[FloatArray, FloatArray] = none, none  # distances, relative yaws
        self._expected: list[int] = []

    def viewpoints(self, rows: IntArray, relative_yaw_deg: FloatArray) -> Viewpoints:
        """Return the renderings of some scans as the query would see them."""
        model, harmonic = self._model, np.arange(self._harmonics_seen)
        step_deg = min(_MOST_STEP_DEG, 360.0 / (_SAMPLES_A_WAVE * max(1, model.ranks[1] - 1)))
        headings_deg = relative_yaw_deg + step_deg * np.array([[-1.0], [0.0], [1.0]])
        turned = np.exp(1j * np.radians(headings_deg)[..., None] * harmonic)
        stored = model.renderings.at(rows)[..., : len(harmonic)]
        seen = self._seen(stored.astype(np.complex128) * turned[:, :, None, None])
        return Viewpoints(
            self._as_numbers(self._values),
            self._as_numbers(seen),
            step_deg,
            model.lateral_offset_m,
        )

    @property
    def _harmonics_seen(self) -> int:
        """How many harmonics of a rendering `_seen` depends on."""
        return self._model.ranks[1]

    def _seen(self, renderings: ComplexArray) -> ComplexArray:
        """Return what the query's scan would have seen of `(..., r1, r2)` renderings."""
        return renderings

    def _as_numbers(self, signatures: ComplexArray) -> FloatArray:
        """Return r1 (2 r2 - 1) real numbers of the same norm for each signature."""
        *shape, r2 = signatures.shape
        parts, roots = np.empty((*shape, 2 * r2 - 1)), self._roots[:r2]
        np.multiply(signatures.real, roots, out=parts[..., :r2])
        np.multiply(signatures.imag[..., 1:], roots[1:], out=parts[..., r2:])
        return parts.reshape(*shape[:-1], -1)

    def nearest(self, k: int, among: BoolArray | None = None) -> Neighbours:
        """Return the `k` nearest scans, each by its nearest rendering, nearest first."""
        count = len(self._model) if among is None else np.count_nonzero(among)
        if not count:
            return Neighbours.of_distances(np.empty(0, np.int64), np.empty(0))
        if count <= max(k, FIRST):
            rows = np.arange(count) if among is None else np.flatnonzero(among)
            return self.ranked(rows, *self.compared(rows), k)
        lower = self._lower_bounds if among is None else np.where(among, self._lower_bounds, np.inf)
        searched = nearest(lower, max(k, FIRST))
        last = lower[searched[-1]]  # no other scan has less
        searched.sort()
        distances, yaw_deg = self.compared(searched)
        found = self.ranked(searched, distances, yaw_deg, k)
        if found.distances[-1] < last:
            return found
        left = lower <= found.distances[-1]
        left[searched] = False
        rows = np.flatnonzero(left)
        while len(rows):  # the likeliest ones first: they exclude others
            likeliest = nearest(lower[rows], max(_AT_ONCE, FIRST * len(searched)))
            more = self.compared(rows[likeliest])
            searched = np.concatenate([searched, rows[likeliest]])
            distances = np.concatenate([distances, more[0]])
            yaw_deg = np.concatenate([yaw_deg, more[1]])
            rows = np.delete(rows, likeliest)
            rows = rows[lower[rows] <= _reached(distances, k)]
        in_order = np.argsort(searched)
        return self.ranked(searched[in_order], distances[in_order], yaw_deg[in_order], k)

    def distances_of(self, rows: IntArray) -> FloatArray:
        """Return the distances of some scans; those of `nearest` are not computed again."""
        return np.asarray(self.compared(rows)[0].min(axis=1))

    def expect(self, rows: IntArray) -> None:
        """Compare these together with the next scans: two calls for a few take longer than one."""
        self._expected = rows.tolist()

    def compared(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return what `exact` does of some scans, of each computed once and kept."""
        wanted, places = rows.tolist(), self._place_of_row
        if not places and not self._expected and len(wanted) <= self.block_scans:
            places.update(zip(wanted, range(len(wanted)), strict=True))
            self._compared = self.exact(rows)  # most searches need no others
            return self._compared
        missing = [row for row in dict.fromkeys(wanted) if row not in places]
        if missing:
            both = dict.fromkeys(missing + self._expected)
            missing, self._expected = [row for row in both if row not in places], []
        for start in range(0, len(missing), self.block_scans):
            block = missing[start : start + self.block_scans]
            begin = len(self._compared[0])
            places.update(zip(block, range(begin, begin + len(block)), strict=True))
            distances, yaw_deg = self.exact(np.array(block))
            self._compared = (
                np.concatenate([self._compared[0], distances]),
                np.concatenate([self._compared[1], yaw_deg]),
            )
        chosen = [places[row] for row in wanted]
        distances, yaw_deg = self._compared
        return distances[chosen], yaw_deg[chosen]

    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return each scan's distance, that of its nearest rendering, infinite outside `among`."""
        distances = np.full(len(self._model), np.inf)
        rows = np.arange(len(distances)) if among is None else np.flatnonzero(among)
        for start in range(0, len(rows), self.block_scans):
            block = rows[start : start + self.block_scans]
            distances[block] = self.exact(block)[0].min(axis=1)
        return distances

    def nearest_distances(self, sets: Sequence[BoolArray]) -> list[float]:
        """Return the exact distance of the nearest scan of each of some sets, infinite without one.

        Most scans are excluded by their lower bounds.
        """
        return [float(self.nearest(1, among).distances.min(initial=np.inf)) for among in sets]

    def distances_for_belief(self) -> FloatArray:
        """Return each scan's distance, as `distances` but in single precision.

        Headings are products with one matrix: a tenth of the time of transforms.
        """
        model, samples = self._model, self._samples_of_headings
        renderings = model.renderings
        unit = self._unit
        angles = 2.0 * np.pi / samples * np.outer(np.arange(unit.shape[1]), np.arange(samples))
        in_headings = np.stack([np.cos(angles), -np.sin(angles)], axis=1).astype(np.float32)
        in_headings = in_headings.reshape(-1, samples)
        share = np.empty(renderings.norms.size, np.float32)
        for whole in renderings.blocks:
            waves = renderings.waves(unit, whole)
            parts = waves.reshape(len(in_headings), -1)
            for start in range(0, parts.shape[1], _HEADINGS_ONCE):
                block = slice(start, start + _HEADINGS_ONCE)
                best, _ = peaks((parts[:, block].T @ in_headings)[:, None])
                at = slice(
                    whole.start + start, min(whole.start + start + _HEADINGS_ONCE, whole.stop)
                )
                share[at] = np.minimum(best[:, 0], in_phase(waves[..., block]))
        of_scan = share.reshape(renderings.norms.T.shape)
        if model.measure == Distance.NORMALISED:
            return np.asarray(np.maximum(1.0 - of_scan.max(axis=0).astype(np.float64), 0.0))
        norms = renderings.norms.T
        return np.asarray(self._plain(of_scan * (self._norm * norms), norms).min(axis=0))

    def least_distances(self) -> FloatArray | Float32Array:
        """Return lower bounds: with all waves in phase."""
        return self._lower_bounds

    def ranked(
        self, rows: IntArray, distances: FloatArray, yaw_deg: FloatArray, k: int
    ) -> Neighbours:
        """Return the `k` nearest of some scans that `exact` compared."""
        order: IntArray | slice
        rendering: IntArray | slice
        if k == 1:  # the first of the least distances
            scan, best = divmod(int(distances.argmin()), distances.shape[1])
            order, rendering = slice(scan, scan + 1), slice(best, best + 1)
        else:
            order = nearest(distances.min(axis=1), k)
            rendering = distances[order].argmin(axis=1)
        yaw_deg = yaw_deg[order, rendering].reshape(-1)
        return Neighbours(
            rows[order],
            distances[order, rendering].reshape(-1),
            yaw_deg if self._model.gives_relative_yaw else np.full(len(yaw_deg), np.nan),
            self._model.lateral_offset_m[rendering],
        )

    @cached_property
    def _lower_bounds(self) -> FloatArray | Float32Array:
        """Lower bounds of the distance of every scan, the nearest of its renderings, `(K,)`."""
        model, unit = self._model, self._unit
        if model.measure == Distance.NORMALISED:
            return np.asarray(np.float32(1.0 - SLACK) - model.renderings.best_in_phase(unit))
        correlation = np.empty(model.renderings.norms.size, np.float32)
        for block in model.renderings.blocks:
            correlation[block] = in_phase(model.renderings.waves(unit, block))
        norms = model.renderings.norms.T
        at_most = (correlation.reshape(norms.shape).astype(np.float64) + SLACK) * (
            self._norm * norms
        )
        plain: FloatArray = self._plain(at_most, norms).min(axis=0)
        return plain * (1.0 - _ROUNDING)

    @cached_property
    def _unit(self) -> Complex64Array:
        """The query, of norm 1 and weighted by sqrt(w_m)."""
        unit = self._values / (self._norm or 1.0) * self._roots
        return unit.astype(np.complex64)

    def exact(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Search the headings of all renderings of some scans.

        Every step rounds each scan alone: the result is the same for one scan as for all.

        Returns:
            Distances and relative yaws in degrees, counter-clockwise from the map's scan, `(n, D)`
            each.
        """
        stored = self._model.renderings.at(rows)
        waves = (self._of_pairs * stored.conj()).sum(axis=2)
        magnitudes = np.abs(waves)
        at_most = 2.0 * magnitudes.sum(axis=-1) - magnitudes[..., 0]
        samples = self._samples_of_headings
        best, yaw_deg = peaks(np.fft.irfft(waves, samples, axis=-1, norm="forward"))
        return self._distance(np.minimum(best, at_most), rows), yaw_deg

    @cached_property
    def _of_pairs(self) -> ComplexArray:
        """The query as `irfft` reads it."""
        return np.asarray(self._values * _pairs(self._model.columns, self._values.shape[1]))

    @property
    def _samples_of_headings(self) -> int:
        return max(8, 1 << (_SAMPLES_A_WAVE * self._model.ranks[1] - 1).bit_length())

    def _distance(self, correlation: FloatArray, rows: IntArray) -> FloatArray:
        norms = self._model.renderings.norms[rows]
        if self._model.measure == Distance.PLAIN:
            return self._plain(correlation, norms)
        both = self._norm * norms
        return np.maximum(1.0 - correlation / np.where(both > 0.0, both, np.inf), 0.0)

    def _plain(self, correlation: FloatArray, norms: FloatArray) -> FloatArray:
        return np.maximum(self._norm * self._norm + norms * norms - 2.0 * correlation, 0.0)


@lru_cache(maxsize=16)
def _pairs(columns: int, r2: int) -> FloatArray:
    """Return w_m for `irfft`, which counts harmonics twice but the first: J/2 has no pair."""
    pairs = weights(columns, r2) / 2.0
    pairs[0] = 1.0
    return frozen(pairs, np.float64)


def _reached(distances: FloatArray, k: int) -> np.float64:
    """Return the distance within which there are `k` of the `(n, D)` compared scans."""
    found: np.float64 = np.partition(distances.min(axis=1), k - 1)[k - 1]
    return found


def peaks(waves: FloatArray | Float32Array) -> tuple[FloatArray, FloatArray]:
    """Return the largest value over headings, between samples, and the relative yaw in degrees.

    Args:
        waves: `(n, D, samples)` of evenly spaced headings.
    """
    samples = waves.shape[-1]
    peak = waves.argmax(axis=-1)
    # Indices by hand: `take_along_axis` costs as much as all the rest for a few scans.
    flat = waves.reshape(-1)
    begin = np.arange(0, len(flat), samples).reshape(peak.shape)
    before, at, after = flat[begin + (peak + _BESIDE) % samples]
    curvature = 2.0 * at - before - after
    slope = after - before
    offset = 0.5 * slope / np.where(curvature > 0.0, curvature, np.inf)
    best = at + 0.25 * slope * offset
    return best, wrapped_deg((peak + offset) * (-360.0 / samples))
