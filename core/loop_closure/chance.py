"""What a comparison of two scans shows beyond what any two scans have in common."""

import numpy as np

from core.arrays import Float32Array, FloatArray

_LEAST = 1e-6  # of what is possible: where all alignments are the same, nothing is above chance


def above_chance(cosines: FloatArray | Float32Array) -> float:
    """Return the best cosine above the median, as a share of the most that is possible.

    Dense surroundings are alike in any alignment: docs/decisions/0015-loop-closures.md.

    Args:
        cosines: Of two scans in all alignments that are tried, any shape.

    Examples:
        >>> round(above_chance(np.array([0.2, 0.2, 0.6])), 9), above_chance(np.ones(3))
        (0.5, 0.0)
    """
    by_chance = float(np.median(cosines))
    return (float(cosines.max()) - by_chance) / max(1.0 - by_chance, _LEAST)
