"""The azimuths that a scan saw, as what they leave of harmonics.

Let w be 1 in the columns that the scan saw and 0 elsewhere, and W its harmonics. An image times w
has harmonics that are mixtures of the image's: harmonic m gets W_(m - k) of harmonic k.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import ComplexArray
from core.projection.visibility import SECTORS, View, sector_of_column

_LEAST_LEFT = 0.005  # by a window, of a mixture: with less, what its scan saw otherwise would count


@dataclass(frozen=True)
class Window:
    """What a view leaves of harmonics.

    Attributes:
        view: Whose hidden sectors are left out.
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
