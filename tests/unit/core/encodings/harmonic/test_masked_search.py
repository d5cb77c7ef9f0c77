import functools
from dataclasses import replace

import numpy as np
import pytest

from core.encodings.signature import LARGEST, Signature
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


@pytest.mark.parametrize("r2", [12, 60, 100])
def test_a_signature_that_is_turned_by_part_of_a_degree_is_as_near_as_before(r2):
    localizer = localizer_of((5, r2))
    row = 4
    own = localizer.map.model.recorded[row]
    for turn_deg in (0.0, 0.7, 1.4, 2.1):
        turned = own * np.exp(1j * np.deg2rad(turn_deg) * np.arange(r2))
        signature = Signature(turned.astype(np.complex64), None, localizer.basis.digest)
        best = localizer.localize_signatures([signature]).best
        assert best.row == row
        assert best.distance < 0.01
        assert abs(best.relative_yaw_deg) == pytest.approx(turn_deg, abs=0.2)


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


@pytest.mark.parametrize("hidden", [(), tuple(range(8))])
def test_a_signature_of_the_largest_numbers_is_compared_as_a_smaller_one(hidden):
    scans, localizer = recording().scans, localizer_of()
    (signature,) = localizer.basis.encode(localizer.basis.image(scans[9]))
    model = localizer.map.model
    of_towers = replace(
        model, stored=replace(model.stored, scales=model.stored.scales * np.float32(1e6))
    )
    large = signature.values * np.float32(0.9 * LARGEST / np.abs(signature.values).max())
    found = [
        of_towers.search([replace(signature, values=values, view=View(hidden))]).distances()
        for values in (signature.values, large)
    ]
    np.testing.assert_allclose(found[1], found[0], atol=1e-5)


@pytest.mark.parametrize("views", ["full", "any"])
def test_the_nearest_of_each_set_is_that_of_all_its_distances(views):
    parameters = MapParameters.for_sensor(views=views)
    drive = MemoryDrive("block", recording().scans)
    localizer = Localizer(build([drive], parameters, calibrated=False).tensor_map)
    signatures = localizer.basis.encode(localizer.basis.image(recording().scans[7]))
    count = len(localizer.map)
    sets = [np.arange(count) % 3 == 1, np.arange(count) == 12, np.zeros(count, bool)]
    search = localizer.map.model.search(signatures)
    distances = search.distances()
    expected = [distances[among].min(initial=np.inf) for among in sets]
    assert search.nearest_distances(sets) == pytest.approx(expected, abs=1e-6)
