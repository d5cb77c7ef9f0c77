"""One harmonic signature of a scan that saw a part of its place, compared with every rendering.

Let w be 1 in the columns that the scan saw and 0 elsewhere. Its signature q is of the image times
w. What that scan would have seen of a rendering M in heading t is w M(t), so their likeness is

    score(t) = <B q, T M(t)> / (|B q| |T M(t)|), T_mk = sum_n B_mn W_(n - k), W the harmonics of w,

cut to the harmonics of q: at most 1, and that of the whole images where w is 1 everywhere. In a
narrow window few harmonics say nearly the same, which would count many times: B, the inverse root
of what the window leaves of each mixture of them, makes the products those of images within the
window. It is 1 where nothing is hidden.
<B q, T M(t)> is the correlation of M with one other signature, T* B q. |T M(t)|^2 differs between
headings: it is a sum of waves whose coefficients are sums along the diagonals of M* M, each product
weighted with T* T. They are computed for the scans that a cheaper denominator prefers: |w M(t)|,
the correlation of w with where on the circle the energy of M is.

A rendering does not see everything either, and only the part of q should count that it sees. How
much of q's energy that is, its share, is known from few harmonics and so not exactly: the score is
divided by 1 - r2 / 48 (1 - share), which trusts it the more the more harmonics there are, wholly
from 48 on, and the distance becomes half at most (docs/reference/any-view-measurements.md).

Where less is compared, more is alike by chance: distances say the less of whether a match is right,
as the root of the share of the cells that the query sees.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.arrays import (
    BoolArray,
    ComplexArray,
    Float32Array,
    FloatArray,
    IntArray,
)
from core.encodings.harmonic.headings import in_headings, over_headings, samples_for, turns_of
from core.encodings.harmonic.in_phase import in_phase
from core.encodings.harmonic.renderings import LEAST_SEEN
from core.encodings.harmonic.search import FIRST, SLACK, HarmonicSearch, peaks
from core.encodings.harmonic.window import Window, diagonal_sums, evened_mixing, window_of
from core.encodings.harmonics import circular_energy, energy, of_usual_norm, two_sided
from core.encodings.search import Neighbours, nearest, nearest_of_sets
from core.projection.visibility import SECTORS, View

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel

_ESTIMATED_HEADINGS = 24  # with 66 the same are preferred: reference/any-view-measurements.md
_MIXED = 4  # harmonics beyond those that are sent, which a mask mixes into them, in an estimate
_ESTIMATED_ONCE = 1024  # renderings, in the processor's cache
_EXACT_ONCE = 144  # scans of which the best rendering is compared exactly
_ONE_RENDERING_ONCE = 240  # scans of which one rendering is compared exactly, in the cache
_EXACT_SCANS = 24  # of which all renderings are
_HIDDEN_IN_PHASE = SECTORS // 5  # if more are, many scans may be near with all waves in phase
_TRUSTING_HARMONICS = 48  # with as many the share of the query's energy would be trusted


class MaskedSearch(HarmonicSearch):
    """One harmonic signature with hidden sectors, compared with every rendering of every scan.

    The nearest scans are found among the best estimates and compared exactly. Of a whole view the
    likeliest ones are first: their distances exclude others, whose scores with all waves in phase
    say how near they may be.
    """

    block_scans = 2 * _EXACT_SCANS  # in the processor's cache
    most_exact: ClassVar[float] = 1024  # scans, in 0.1 s

    def __init__(self, model: "HarmonicModel", values: ComplexArray, view: View) -> None:
        values = of_usual_norm(values, model.columns)
        super().__init__(model, values)
        self.evidence = math.sqrt(view.share_of(model.grid_shape[0]))
        kept, sent = model.ranks[1], values.shape[1]
        self._partial, self._narrow = len(view.hidden) > 0, view.is_narrow
        self._view, self._sent = view, values
        self.short_reach = view.has_short_reach
        spread = values
        if self._partial:
            within = two_sided(values) @ self._window.evening.T
            self._values = within[:, sent - 1 :]
            self._norm = math.sqrt(energy(self._values, model.columns))
            spread = (within @ self._toeplitz.conj())[:, kept - 1 :]
        mixed = min(spread.shape[1], sent + _MIXED)
        unit = spread[:, :mixed] / (self._norm or 1.0) * self._roots[:mixed]
        self._estimated = unit.astype(np.complex64)
        self._spread = spread.astype(np.complex64)
        self._last: tuple[slice, Float32Array] | None = None

    @cached_property
    def _window(self) -> Window:
        return window_of(self._view, self._model.columns, self._sent.shape[1])

    @property
    def _toeplitz(self) -> ComplexArray:
        """T: from the kept harmonics to those that are sent, both two-sided."""
        return evened_mixing(self._window, self._model.ranks[1])

    @cached_property
    def _unit_energy(self) -> ComplexArray:
        """The query's energy, as a map's: where on the circle it is, and 1 in all."""
        found = np.zeros(2 * self._model.ranks[1] - 1, np.complex128)
        of_sent = circular_energy(self._sent)
        found[: len(of_sent)] = of_sent
        return found / (found[0].real or 1.0)

    def nearest(self, k: int, among: BoolArray | None = None) -> Neighbours:
        """Return the `k` nearest scans, each by its nearest rendering, nearest first."""
        rows = self._preferred(k, among)
        if not len(rows):
            return Neighbours.of_distances(np.empty(0, np.int64), np.empty(0))
        first = max(k, FIRST)
        if self.verified or self._partial or self._narrow or len(rows) <= first:
            return self._ranked(rows, k)
        found = self._ranked(rows[:first], k)
        left = self._least_distances_of(rows[first:]) <= found.distances[-1]
        if not left.any():
            return found
        return self._ranked(np.concatenate([rows[:first], rows[first:][left]]), k)

    def _ranked(self, rows: IntArray, k: int) -> Neighbours:
        rows = np.sort(rows)  # of equal distances the first scan's is the nearest
        return self.ranked(rows, *self.compared(rows), k)

    def _least_distances_of(self, rows: IntArray) -> Float32Array:
        """Return what no distance of some scans is below, of a whole view, by their best scores.

        These have all waves in phase, and `LEAST_SEEN` is added in them to what is seen.
        """
        share = np.maximum(self._energy_shares[rows].min(axis=1), LEAST_SEEN)
        at_most = self._best_scores[rows] * np.sqrt(1.0 + LEAST_SEEN / share)
        at_most *= np.float32(1.0 + SLACK + _beyond_peak(self._values.shape[1]))
        if not self._model.seen.all:
            at_most = 0.5 * (1.0 + at_most)  # half the distance is left, whatever is not seen
        return np.asarray(1.0 - at_most)

    def distances(self, among: BoolArray | None = None) -> FloatArray:
        """Return each scan's distance, that of its nearest rendering, infinite outside `among`.

        Of many scans all are estimates: exact ones among them would be nearer or farther than
        others by more than scans differ.
        """
        among = np.ones(len(self._model), bool) if among is None else among
        if np.count_nonzero(among) <= self.most_exact:
            return super().distances(among)
        return np.where(among, self._estimates, np.inf)

    @property
    def is_estimated(self) -> bool:
        """Whether the map has too many scans to compare each exactly."""
        return len(self._model) > self.most_exact

    def nearest_distances(self, sets: Sequence[BoolArray]) -> list[float]:
        """Return the exact distance of the nearest scan of each of some sets, as queries find it.

        Of few scans all are compared exactly, as by `distances`.
        """
        if self.is_estimated:
            return super().nearest_distances(sets)
        return nearest_of_sets(self.distances(), sets)

    def distances_for_belief(self) -> FloatArray:
        """Return each scan's distance: estimates of many scans, of fewer that of one rendering.

        It is the rendering with the best estimate, compared exactly; of the nearest scans all are.
        """
        if self.is_estimated:
            return self.distances()
        rendering = self._squared_scores.argmax(axis=0)[:, None]
        distances = np.empty(len(rendering))
        for start in range(0, len(distances), _ONE_RENDERING_ONCE):
            rows = np.arange(start, min(start + _ONE_RENDERING_ONCE, len(distances)))
            distances[rows] = self.exact(rows, rendering[rows])[0][:, 0]
        near = nearest(distances, _EXACT_SCANS)
        distances[near] = self.distances_of(near)
        return distances

    def least_distances(self) -> FloatArray:
        """Return the distances with all waves in phase, or as estimated if a view hides much.

        In a partial view each rendering's energy counts as if it were the same in all headings:
        where a window has more of it, the distance is larger.
        """
        if not self._partial:
            return np.maximum(1.0 - self._best_scores.astype(np.float64), 0.0)
        if len(self._view.hidden) > _HIDDEN_IN_PHASE:
            return self._estimates
        best = self._model.renderings.best_in_phase(self._estimated, self._values.shape[1])
        in_window = float(self._window.mask[0].real)
        return np.maximum(1.0 - best.astype(np.float64) / math.sqrt(in_window), 0.0)

    def _preferred(self, k: int, among: BoolArray | None) -> IntArray:
        """Return the rows of the scans to compare exactly, the likeliest ones first.

        Of narrow views estimates are worse: of more scans, the rendering with the best estimate is
        compared first.
        """
        searched = len(self._model) if among is None else int(np.count_nonzero(among))
        if searched <= max(k, _EXACT_SCANS):
            return np.arange(searched) if among is None else np.flatnonzero(among)
        count = _EXACT_ONCE if self._narrow else _EXACT_SCANS
        unlike = -self._best_scores
        if among is not None:
            unlike[~among] = np.inf
        some = nearest(unlike, min(max(k, count), searched))
        if len(some) > max(k, _EXACT_SCANS):
            scores = self._squared_scores if self._partial else self._phase_free_scores
            rendering = scores[:, some].argmax(axis=0)[:, None]
            some = some[nearest(self.exact(some, rendering)[0][:, 0], max(k, _EXACT_SCANS))]
        return some

    @cached_property
    def _estimates(self) -> FloatArray:
        """Estimated distance of every scan, the nearest of its renderings, `(K,)`."""
        best = np.sqrt(np.maximum(self._squared_scores.max(axis=0), 0.0))
        estimates: FloatArray = np.maximum(1.0 - best.astype(np.float64), 0.0)
        return estimates

    def _waves(self, block: slice) -> Float32Array:
        """Return the correlation with some renderings as waves over headings, `(r2, 2, n)`.

        The last block is kept: of a small map, the only one.
        """
        if self._last is None or self._last[0] != block:
            self._last = block, self._model.renderings.waves(self._estimated, block)
        return self._last[1]

    @cached_property
    def _best_scores(self) -> Float32Array:
        """The best score of each scan's renderings, by which scans are ranked, `(K,)`."""
        renderings = self._model.renderings
        if self._partial:
            return np.asarray(self._squared_scores.max(axis=0))
        if not self._narrow:
            return renderings.best_in_phase(self._estimated, self._values.shape[1])
        return np.asarray(self._phase_free_scores.max(axis=0))

    @cached_property
    def _phase_free_scores(self) -> Float32Array:
        """What the scores of a whole view would be with all waves in phase, `(D, K)`."""
        seen = self._model.renderings.energy_share(self._values.shape[1])
        at_most = np.empty(len(seen), np.float32)
        for block in self._model.renderings.blocks:
            at_most[block] = in_phase(self._waves(block))
        at_most /= np.sqrt(seen + LEAST_SEEN)
        return at_most.reshape(len(self._model.lateral_offset_m), -1)

    @cached_property
    def _squared_scores(self) -> Float32Array:
        """Estimated squares of the best score of every rendering over headings, `(D, K)`."""
        model, samples = self._model, _ESTIMATED_HEADINGS
        r2 = self._values.shape[1]
        if self._partial:
            energies = model.renderings.unit_energies(r2)
            of_mask = in_headings(self._window.mask[: len(energies) // 2 + 1], samples)
        else:
            energies, of_mask = model.renderings.energy_share(r2)[None], np.ones((1, 1), np.float32)
        if not model.seen.all:
            of_energy = in_headings(self._unit_energy[: model.seen.slow], samples)
        turns = turns_of(samples, self._estimated.shape[1])
        correlated = np.stack([turns.real, -turns.imag], axis=2).astype(np.float32)
        correlated = correlated.reshape(samples, -1)
        best = np.empty(energies.shape[1], np.float32)
        for whole in model.renderings.blocks:
            waves = self._waves(whole)
            for start in range(whole.start, whole.stop, _ESTIMATED_ONCE):
                block = slice(start, min(start + _ESTIMATED_ONCE, whole.stop))
                near = slice(start - whole.start, block.stop - whole.start)
                score = correlated @ waves[..., near].reshape(correlated.shape[1], -1)
                score *= np.abs(score)
                seen = of_mask @ energies[:, block]
                np.maximum(seen, 0.0, out=seen)  # by so few waves a share may be below 0
                seen += LEAST_SEEN
                if not model.seen.all:
                    part = self._part_seen(of_energy @ model.seen.waves(block))
                    seen = seen * np.square(part, out=part)
                score /= seen
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
        model = self._model
        samples = samples_for(self._spread.shape[1])
        stored = model.renderings.at(rows, renderings)
        chosen = rows if renderings is None else (rows[:, None], renderings)
        waves = (self._spread * stored[..., : self._spread.shape[1]].conj()).sum(axis=2)
        norms = model.renderings.norms[chosen].astype(np.float32)
        if self._partial:
            parts = stored.view(np.float32)  # a real and an imaginary part of each
            # Of one array, not copied, a product with itself takes twice as long.
            products = np.ascontiguousarray(parts.swapaxes(-1, -2)) @ parts
            # One product of two matrices, not one for each scan: that takes three times as long.
            flat = products.reshape(products.shape[0] * products.shape[1], -1)
            sums = (flat @ diagonal_sums(self._window, model.ranks[1])).view(np.complex64)
            seen = over_headings(sums.reshape(*products.shape[:2], -1), samples)
            np.maximum(seen, LEAST_SEEN * np.square(norms)[..., None], out=seen)
            score = over_headings(waves, samples)
            score /= _divisor(np.sqrt(seen, out=seen) * self._norm)
        else:  # the same in each heading
            share = self._energy_shares[chosen]
            seen = norms * np.sqrt(np.maximum(share, LEAST_SEEN))
            waves /= _divisor(seen * self._norm)[..., None]
            score = over_headings(waves, samples)
        if not model.seen.all:
            known = 2 * self._values.shape[1] - 1
            of_energy = in_headings(self._unit_energy[:known], samples)
            if renderings is None:
                renderings = np.arange(stored.shape[1])[None]
            by_map = model.seen.harmonics(rows[:, None], renderings, known)
            shares = (by_map.reshape(len(by_map), -1).T @ of_energy.T).reshape(score.shape)
            # A share that is not exact must not make two alike that are not.
            at_most = score + np.float32(1.0)
            at_most *= np.float32(0.5)
            score /= self._part_seen(shares)
            np.minimum(score, at_most, out=score)
        best, yaw_deg = peaks(score)
        return np.maximum(1.0 - best.astype(np.float64), 0.0), yaw_deg

    @property
    def _energy_shares(self) -> Float32Array:
        """The share of each rendering's energy that the harmonics have that are sent, `(K, D)`."""
        found = self._model.renderings.energy_share(self._values.shape[1])
        return found.reshape(-1, len(self._model)).T

    @property
    def _harmonics_seen(self) -> int:
        # A window mixes harmonics beyond those that are sent into them; a whole view does not.
        return self._model.ranks[1] if self._partial else self._values.shape[1]

    def _seen(self, renderings: ComplexArray) -> ComplexArray:
        if not self._partial:
            return renderings
        return np.asarray(two_sided(renderings) @ self._toeplitz[len(self._toeplitz) // 2 :].T)

    def _part_seen(self, shares: Float32Array) -> Float32Array:
        """Return 1 - r2 / 48 (1 - share), in place of the shares; from 48 on these themselves."""
        trust = np.float32(min(self._values.shape[1] / _TRUSTING_HARMONICS, 1.0))
        shares *= trust
        shares += np.float32(1.0) - trust
        if trust == 1.0:  # nothing else keeps them above 0
            np.maximum(shares, LEAST_SEEN, out=shares)
        return shares


def _beyond_peak(r2: int) -> float:
    """Return how far a parabola through three samples may be above all waves in phase.

    As a share of these: h^3 f''' / (9 sqrt(3)), of the highest harmonic.
    """
    return (2.0 * math.pi / samples_for(r2) * (r2 - 1)) ** 3 / (9.0 * math.sqrt(3.0))


def _divisor(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return what makes 0 of what has nothing to compare."""
    return np.where(values > 0.0, values, np.inf)
