"""Circular harmonics in azimuth."""

import numpy as np
import pytest

from core.encodings.harmonics import circular_energy


@pytest.mark.parametrize("count", [None, 1, 4, 100])
@pytest.mark.parametrize("shape", [(1, 1), (6, 7), (10, 12)])
def test_the_energy_of_one_signature_is_that_of_it_among_others(shape, count):
    rng = np.random.default_rng(0)
    signatures = rng.normal(size=(2, *shape)) + 1j * rng.normal(size=(2, *shape))
    signatures[..., 0] = signatures[..., 0].real
    alone = circular_energy(signatures[0], count)
    np.testing.assert_allclose(alone, circular_energy(signatures, count)[0], atol=1e-12)
