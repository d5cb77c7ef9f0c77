import functools
from dataclasses import replace

import numpy as np
import pytest

from core.encodings.signature import Signature
from core.localization.localizer import Localizer
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.projection.visibility import View
from core.scans.drive import MemoryDrive
from tests.support.recording import recording


@functools.cache
def localizer_of(ranks=None):
    """Return the localizer of a map of every fourth scan, without a probability."""
    parameters = MapParameters.for_sensor(ranks=ranks)
    drive = MemoryDrive("block", recording().scans[::4])
    return Localizer(build([drive], parameters, calibrated=False).tensor_map)


def test_signatures_of_more_harmonics_than_are_trusted_find_their_places():
    scans, localizer = recording().scans, localizer_of((5, 100))
    nothing = Signature(np.zeros((5, 100), np.complex64), None, localizer.basis.digest)
    assert localizer.localize_signatures([nothing]).best.distance > 0.4
    for at in (9, 11, 13, 15, 17, 19):
        signatures = localizer.basis.encode(localizer.basis.image(scans[at]))
        assert abs(localizer.localize_signatures(signatures).best.row - at / 4) <= 0.5


@pytest.mark.parametrize("hidden", [(), tuple(range(8))])
@pytest.mark.parametrize("size", [1e-30, 1e-40, 1e-43, 1e-45])
def test_a_signature_of_the_smallest_numbers_is_compared_as_a_larger_one(hidden, size):
    scans, localizer = recording().scans, localizer_of()
    (signature,) = localizer.basis.encode(localizer.basis.image(scans[9]))
    tiny = (signature.values.astype(np.complex128) * size).astype(np.complex64)
    large = (tiny.astype(np.complex128) / size).astype(np.complex64)  # as much of them is left
    found = [
        localizer.localize_signatures([replace(signature, values=values, view=View(hidden))]).best
        for values in (tiny, large)
    ]
    assert found[0].row == found[1].row
    assert found[0].distance == pytest.approx(found[1].distance, abs=1e-5)
