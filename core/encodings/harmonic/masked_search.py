"""One harmonic signature of a scan that saw a part of its place, compared with every rendering.

Let w be 1 in the columns that the scan saw and 0 elsewhere. Its signature q is of the image times
w. What that scan would have seen of a rendering M in heading t is w M(t), so their likeness is

    score(t) = <q, T M(t)> / (|q| |T M(t)|), T_mk = W_(m - k), W_n the harmonics of w,

cut to the harmonics of q: at most 1, and that of the whole images where w is 1 everywhere.
<q, T M(t)> is the correlation of M with one other signature, T* q. |T M(t)|^2 differs between
headings: it is a sum of waves whose coefficients are sums along the diagonals of M* M, each product
weighted with T* T. They are computed for the scans that a cheaper denominator prefers: |w M(t)|,
the correlation of w with where on the circle the energy of M is.

A rendering does not see everything either, and only the part of q should count that it sees. How
much of q's energy that is, its share, is known from few harmonics and so not exactly: the score is
divided by 1 - r2 / 48 (1 - share), which trusts it the more the more harmonics there are, and the
distance becomes half at most (docs/decisions/0030-any-view.md).

Where less is compared, more is alike by chance: distances say the less of whether a match is right,
as the root of the share of the cells that the query sees.
"""

import math
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
from core.encodings.harmonic.search import HarmonicSearch, peaks
from core.encodings.harmonics import as_real, circular_energy, energy, two_sided
from core.encodings.model import Neighbours, nearest
from core.projection.visibility import View, sector_of_column

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel

_ESTIMATED_HEADINGS = 24  # with 66 the same scans are preferred: decision 30
_MIXED = 4  # harmonics beyond those that are sent, which a mask mixes into them, in an estimate
_ESTIMATED_ONCE = 1024  # renderings, in the processor's cache
_EXACT_SAMPLES = 128  # between which the peak is found by a parabola
_EXACT_ONCE = 192  # scans of which the best rendering is compared exactly
_EXACT_SCANS = 24  # of which all renderings are
_LEAST_SEEN = np.float32(0.02)  # of a rendering's energy: with less to compare, everything is alike
_TRUSTING_HARMONICS = 48  # with as many the share of the query's energy would be trusted


class MaskedSearch(HarmonicSearch):
    """One harmonic signature with hidden sectors, compared with every rendering of every scan.

    The nearest scans are found among the best estimates and compared exactly.
    """

    block_scans = _EXACT_SCANS
    most_exact: ClassVar[float] = 1024  # scans, in 0.1 s

    def __init__(self, model: "HarmonicModel", values: ComplexArray, view: View) -> None:
        super().__init__(model, values)
        self.evidence = math.sqrt(view.share_of(model.grid_shape[0]))
        columns, kept, sent = model.columns, model.ranks[1], values.shape[1]
        self._partial, self._narrow = len(view.hidden) > 0, view.is_narrow
        seen = ~np.isin(sector_of_column(columns), view.hidden)
        self._mask = np.fft.fft(seen) / columns
        sent_harmonics = np.arange(1 - sent, sent)
        toeplitz = self._mask[(sent_harmonics[:, None] - np.arange(1 - kept, kept)) % columns]
        self._toeplitz = toeplitz
        self._spread = (two_sided(values) @ toeplitz.conj())[:, kept - 1 :]
        mixed = min(kept, sent + _MIXED) if self._partial else sent
        unit = self._spread[:, :mixed] / (self._norm or 1.0) / np.sqrt(self._weights[:mixed])
        self._estimated = unit.astype(np.complex64)
        self._last: tuple[slice, Complex64Array] | None = None
        # Of the query's energy, as of a map's: where on the circle it is, and 1 in all.
        found = np.zeros(2 * kept - 1, np.complex128)
        found[: 2 * sent - 1] = circular_energy(values)
        self._unit_energy = found / (found[0].real or 1.0)

    def nearest(self, k: int, among: BoolArray | None = None) -> Neighbours:
        """Return the `k` nearest scans, each by its nearest rendering, nearest first."""
        rows = self._preferred(k, among)
        if not len(rows):
            return Neighbours.of_distances(np.empty(0, np.int64), np.empty(0))
        return self.ranked(rows, *self.exact(rows), k)

    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return each scan's distance, that of its nearest rendering, infinite outside `among`.

        Of many scans all are estimates: exact ones among them would be nearer or farther than
        others by more than scans differ.
        """
        among = np.ones(len(self._model), bool) if among is None else among
        if np.count_nonzero(among) <= self.most_exact:
            return super().distances(among)
        return np.where(among, self._estimates, np.inf)

    def _preferred(self, k: int, among: BoolArray | None) -> IntArray:
        """Return the rows of the scans to compare exactly, rising.

        Of narrow views estimates are worse: of more scans, the rendering with the best estimate is
        compared first.
        """
        rows = np.arange(len(self._model)) if among is None else np.flatnonzero(among)
        count = _EXACT_ONCE if self._narrow else _EXACT_SCANS
        scores = self._squared_scores if self._partial else self._phase_free_scores
        some = rows[nearest(-scores.max(axis=0)[rows], max(k, count))]
        if len(some) > max(k, _EXACT_SCANS):
            rendering = scores.argmax(axis=0)[some][:, None]
            some = some[nearest(self.exact(some, rendering)[0][:, 0], max(k, _EXACT_SCANS))]
        return np.sort(some)

    @cached_property
    def _estimates(self) -> FloatArray:
        """Estimated distance of every scan, the nearest of its renderings, `(K,)`."""
        best = np.sqrt(np.maximum(self._squared_scores.max(axis=0), 0.0))
        estimates: FloatArray = np.maximum(1.0 - best.astype(np.float64), 0.0)
        return estimates

    def _waves(self, block: slice) -> Complex64Array:
        """Return the correlation with some renderings as waves over headings, `(r2, n)`.

        The last block is kept: of a small map, the only one.
        """
        if self._last is None or self._last[0] != block:
            waves = np.empty((self._estimated.shape[1], block.stop - block.start), np.complex64)
            for harmonic, product in enumerate(self._model.waves(self._estimated, block)):
                waves[harmonic] = product
            self._last = block, waves
        return self._last[1]

    @cached_property
    def _phase_free_scores(self) -> Float32Array:
        """What the scores of a whole view would be with all waves in phase, `(D, K)`."""
        seen = self._model.energy_shares(self._values.shape[1])
        at_most = np.empty(len(seen), np.float32)
        for block in self._model.blocks:
            at_most[block] = np.abs(self._waves(block)).sum(axis=0)
        at_most /= np.sqrt(seen + _LEAST_SEEN)
        return at_most.reshape(len(self._model.lateral_offset_m), -1)

    @cached_property
    def _squared_scores(self) -> Float32Array:
        """Estimated squares of the best score of every rendering over headings, `(D, K)`."""
        model, samples = self._model, _ESTIMATED_HEADINGS
        r2 = self._values.shape[1]
        energies = model.unit_energies(r2) if self._partial else model.energy_shares(r2)[None]
        of_mask = _in_headings(self._mask[: len(energies) // 2 + 1], samples)
        of_energy = _in_headings(self._unit_energy[: model.seen.slow], samples)
        correlated = _in_headings(np.ones(self._estimated.shape[1]), samples)
        best = np.empty(energies.shape[1], np.float32)
        for whole in model.blocks:
            waves = self._waves(whole)
            for start in range(whole.start, whole.stop, _ESTIMATED_ONCE):
                block = slice(start, min(start + _ESTIMATED_ONCE, whole.stop))
                near = slice(start - whole.start, block.stop - whole.start)
                score = correlated @ as_real(waves[:, near].conj())
                score *= np.abs(score)
                seen = of_mask @ energies[:, block] if self._partial else energies[:, block].copy()
                seen += _LEAST_SEEN
                score /= seen
                if not model.seen.all:
                    part = self._part_seen(of_energy @ model.seen.waves(block))
                    score /= np.square(part, out=part)
                best[block] = score.max(axis=0)
        return best.reshape(len(model.lateral_offset_m), -1)

    def exact(
        self, rows: IntArray, renderings: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Compare renderings of some scans in all headings.

        Args:
            rows: `(n,)` scans.
            renderings: `(n, d)` of each; all D by default.

        Returns:
            Distances and relative yaws in degrees, counter-clockwise from the map's scan, `(n, d)`
            each.
        """
        model, samples = self._model, _EXACT_SAMPLES
        if renderings is None:
            renderings = np.arange(len(model.lateral_offset_m))[None]
        stored = model.signatures_at(rows, renderings)
        waves = (self._spread * stored.conj()).sum(axis=2)
        if self._partial:
            products = stored.conj().swapaxes(-1, -2) @ two_sided(stored)
            sums = products.reshape(*products.shape[:2], -1).view(np.float32) @ self._diagonal_sums
            seen = np.fft.irfft(sums.view(np.complex64), samples, axis=-1) * samples
        else:
            seen = energy(stored[..., : self._values.shape[1]], model.columns)[..., None]
        floor = _LEAST_SEEN * np.square(model.norms[rows[:, None], renderings])[..., None]
        denominator = self._norm * np.sqrt(np.maximum(seen, floor))
        correlation = np.fft.irfft(waves, samples, axis=-1) * samples
        score = np.divide(
            correlation, denominator, out=np.zeros_like(correlation), where=denominator > 0
        )
        if not model.seen.all:
            of_energy = _in_headings(self._unit_energy, samples)
            by_map = model.seen.harmonics(rows[:, None], renderings)
            shares = np.tensordot(by_map, of_energy, (0, 1))
            # A share that is not exact must not make two alike that are not.
            score = np.minimum(score / self._part_seen(shares), (1.0 + score) / 2.0)
        best, yaw_deg = peaks(score)
        return np.maximum(1.0 - best, 0.0), yaw_deg

    @cached_property
    def _diagonal_sums(self) -> Float32Array:
        """From the products M_m* M_k, m not negative, to the waves of |T M(t)|^2.

        Each product counts with (T* T)_mk for the wave m - k, and so does that of -m and -k, which
        is its conjugate: twice the real part in each heading, of m = 0 once. As real numbers,
        `(2 r2 (2 r2 - 1), 2 (2 r2 - 1))`, real and imaginary parts in turn.
        """
        kept = self._model.ranks[1]
        m, k = np.indices((kept, 2 * kept - 1))
        wave = m - (k - (kept - 1))
        weight = np.where(m > 0, 1.0, 0.5) * np.where(wave == 0, 2.0, 1.0)
        gram = self._toeplitz[:, kept - 1 :].conj().T @ self._toeplitz
        factor = gram * weight
        # A wave of a negative number is the conjugate of that of the positive one.
        sign, wave = np.where(wave < 0, -1.0, 1.0), np.abs(wave)
        sums = np.zeros((*wave.shape, 2, 2 * kept - 1, 2), np.float32)
        sums[m, k, 0, wave, 0], sums[m, k, 0, wave, 1] = factor.real, sign * factor.imag
        sums[m, k, 1, wave, 0], sums[m, k, 1, wave, 1] = -factor.imag, sign * factor.real
        return sums.reshape(2 * wave.size, -1)

    def _seen(self, renderings: ComplexArray) -> ComplexArray:
        return np.asarray(two_sided(renderings) @ self._toeplitz[len(self._toeplitz) // 2 :].T)

    def _part_seen(self, shares: Float32Array) -> Float32Array:
        """Return 1 - r2 / 48 (1 - share), in place of the shares."""
        trust = np.float32(self._values.shape[1] / _TRUSTING_HARMONICS)
        shares *= trust
        shares += np.float32(1.0) - trust
        return shares


def _in_headings(waves: ComplexArray | FloatArray, samples: int) -> Float32Array:
    """Return the matrix from `as_real` of x to sum_d w_d conj(x_d) e^(i d t) in each heading t.

    Args:
        waves: `(m,)` w_d, from d = 0 on; those below 0 are their conjugates.
        samples: Evenly spaced headings, from 0 on.
    """
    turned = _turns(samples, len(waves)) * waves
    return np.concatenate([turned.real, turned.imag[:, 1:]], axis=1).astype(np.float32)


@lru_cache(maxsize=16)
def _turns(samples: int, count: int) -> ComplexArray:
    """Return e^(i d t) in each heading t, twice for harmonics with a conjugate, `(samples, d)`."""
    harmonic = np.arange(count)
    turns = np.exp(2j * np.pi / samples * np.outer(np.arange(samples), harmonic))
    return frozen(turns * np.where(harmonic > 0, 2.0, 1.0), np.complex128)
