"""Beliefs that tests are about."""

import numpy as np

from core.arrays import FloatArray
from core.tracking.belief import Belief


def belief_of_all(at: FloatArray, elsewhere: float) -> Belief:
    """Return a belief of which each pace is kept everywhere, `(2K, P)`."""
    return Belief(np.arange(len(at)), at, np.zeros((2, len(at))), elsewhere)
