"""Small scans for storage tests."""

import numpy as np

from core.scans.scan import Scan


def sample_scan(seed: int, returns: int = 20) -> Scan:
    """Return the scan of that seed."""
    points = np.random.default_rng(seed).normal(scale=10.0, size=(returns, 3))
    return Scan.from_returns(points)
