"""The azimuths that a scan saw, as what they leave of harmonics.

Let w be 1 in the columns that the scan saw and 0 elsewhere, and W its harmonics. An image times w
has harmonics that are mixtures of the image's: harmonic m gets W_(m - k) of harmonic k.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from core.arrays import ComplexArray, Float32Array, FloatArray, IntArray, frozen
from core.projection.visibility import SECTORS, View, sector_of_column

_LEAST_LEFT = 0.005  # by a window, of a mixture: with less, what its scan saw otherwise would count
_KEPT = 64  # views, of 12 harmonics in 7 MB
_SUMS_BYTES = 2**26  # of many harmonics fewer views: of 60 there are four in it, of 92 one


@dataclass(frozen=True)
class Window:
    """What a view leaves of harmonics.

    Attributes:
        view: The view whose hidden sectors are left out.
        columns: J, how many azimuths an image has.
        sent: How many harmonics the query has.
    """

    view: View
    columns: int
    sent: int

    @cached_property
    def mask(self) -> ComplexArray:
        """W, the harmonics of 1 in the columns that the scan saw."""
        visible = np.ones(SECTORS, bool)
        visible[list(self.view.hidden)] = False
        seen = visible[sector_of_column(self.columns)]
        return np.asarray(np.fft.fft(seen) / self.columns)

    def mixing(self, count: int) -> ComplexArray:
        """Return W_(m - k): what of `count` harmonics those that are sent have, both two-sided."""
        apart = np.arange(1 - self.sent, self.sent)[:, None] - np.arange(1 - count, count)
        return np.asarray(self.mask[apart % self.columns])

    @cached_property
    def evening(self) -> ComplexArray:
        """B: the root of (1 + e) / (S + e), S being the mask between harmonics that are sent."""
        left, mixtures = np.linalg.eigh(self.mixing(self.sent))
        weights_of = np.sqrt((1.0 + _LEAST_LEFT) / (np.maximum(left, 0.0) + _LEAST_LEFT))
        return np.asarray((mixtures * weights_of) @ mixtures.conj().T)


@lru_cache(maxsize=_KEPT)
def window_of(view: View, columns: int, sent: int) -> Window:
    """Return the window of a view: a vehicle hides the same from itself in each scan."""
    return Window(view, columns, sent)


@lru_cache(maxsize=_KEPT)
def evened_mixing(window: Window, kept: int) -> ComplexArray:
    """Return T = B W: from `kept` harmonics to those that are sent, both two-sided."""
    return frozen(window.evening @ window.mixing(kept), np.complex128)


def diagonal_sums(window: Window, kept: int) -> Float32Array:
    """Return what makes the products of the parts of M_m and M_k the waves of |T M(t)|^2.

    M_m* M_k counts with (T* T)_mk for the wave m - k, and so does that of -m and -k, which is its
    conjugate: twice the real part in each heading, of m = 0 once. M_-k is the conjugate of M_k, so
    that the products of real and imaginary parts of those with m and k from 0 on are enough.

    Returns:
        `(4 r2^2, 2 (2 r2 - 1))`, real and imaginary parts in turn.
    """
    return _sums_of_views(kept)(window)


@lru_cache(maxsize=4)
def _sums_of_views(kept: int) -> Callable[[Window], Float32Array]:
    """Return what makes the sums of a view, and keeps those of the last views."""
    size_bytes = 32 * kept**2 * (2 * kept - 1)
    views = min(_KEPT, max(1, _SUMS_BYTES // size_bytes))
    return lru_cache(maxsize=views)(partial(_diagonal_sums, kept))


def _diagonal_sums(kept: int, window: Window) -> Float32Array:
    mixing = evened_mixing(window, kept)
    gram = mixing[:, kept - 1 :].conj().T @ mixing
    sums = np.zeros((kept, 2, kept, 2, 2 * kept - 1, 2), np.float32)
    for sign, products in ((1, gram[:, kept - 1 :]), (-1, gram[:, kept - 1 :: -1])):
        at, turned, weight = _waves_of_products(kept, sign)
        factor = products * weight
        of_real = np.stack([factor.real, turned * factor.imag], axis=2)
        of_imaginary = np.stack([-factor.imag, turned * factor.real], axis=2)
        sums[:, 0, :, 0][at] += of_real
        sums[:, 1, :, 1][at] += sign * of_real
        sums[:, 0, :, 1][at] += sign * of_imaginary
        sums[:, 1, :, 0][at] -= of_imaginary
    return frozen(sums.reshape(4 * kept**2, -1), np.float32)


@lru_cache(maxsize=8)
def _waves_of_products(
    kept: int, sign: int
) -> tuple[tuple[IntArray, IntArray, IntArray], FloatArray, FloatArray]:
    """Return m, k and the wave of each product of M_m and M_k, or M_-k, its sign and weight.

    A wave of a negative number is the conjugate of that of the positive one: its sign is -1.
    """
    m, k = np.indices((kept, kept))
    wave = m - sign * k
    weight = np.where(m > 0, 1.0, 0.5) * np.where(wave == 0, 2.0, 1.0)
    if sign < 0:
        weight[:, 0] = 0.0  # M_0 is its own conjugate
    return (m, k, np.abs(wave)), np.where(wave < 0, -1.0, 1.0), weight
