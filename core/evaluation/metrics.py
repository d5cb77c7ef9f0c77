"""Errors of single answers, their medians and shares; scores are in `retrieval`."""

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.scans.angles import wrapped_deg


def apart_m(found: FloatArray, true: FloatArray) -> FloatArray:
    """Return how far apart pose rows are, `(n,)` metres, NaN where one is unknown."""
    return np.asarray(np.linalg.norm(found[..., :3] - true[..., :3], axis=-1))


def heading_error_deg(found_deg: FloatArray, true_deg: FloatArray) -> FloatArray:
    """Return how far headings are apart, 0..180, NaN where one is unknown."""
    return np.asarray(np.abs(wrapped_deg(found_deg - true_deg)))


def median(values: FloatArray) -> float | None:
    """Return the median of the finite values, `None` without one."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def rate(holds: BoolArray) -> float | None:
    """Return the share of which something holds, `None` of nothing."""
    return float(holds.mean()) if len(holds) else None
