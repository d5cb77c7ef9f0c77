"""Signatures of fewer numbers than a map's own queries: found less often, and no less honest."""

import numpy as np
import pytest

from core.errors import InvalidSignature
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.projection.imager import Views
from core.simulation import SimulatedDrive

SCANS = 120
ASKED = range(0, SCANS, 4)


@pytest.fixture(scope="module")
def localizer():
    drive = SimulatedDrive(seed=8101, scans=SCANS)
    return Localizer(build_map(drive, MapParameters.for_sensor(views=Views.ANY)))


@pytest.fixture(scope="module")
def known(localizer):
    """Images of a second pass, and where they were recorded."""
    second = SimulatedDrive(seed=8101, scans=SCANS, traffic_seed=9, lateral_offset_m=1.0)
    return [(localizer.basis.image(second.scan(i)), second.poses[i, :2]) for i in ASKED]


@pytest.fixture(scope="module")
def unknown(localizer):
    """Images of another city."""
    other = SimulatedDrive(seed=8102, scans=SCANS)
    return [localizer.basis.image(other.scan(i)) for i in ASKED]


def localized(localizer, image, ranks):
    return localizer.localize_signatures(localizer.basis.encode(image, ranks))


@pytest.mark.parametrize(
    ("ranks", "most_elsewhere", "least_found"),
    [((5, 5), 0.03, 0.85), ((4, 4), 0.04, 0.7), ((3, 3), 0.1, 0.55)],
)
def test_few_numbers_find_no_place_in_another_city_and_no_wrong_one_in_their_own(
    localizer, known, unknown, ranks, most_elsewhere, least_found
):
    assert localizer.map.calibration is not None
    elsewhere = sum(localized(localizer, image, ranks).localized for image in unknown)
    assert elsewhere <= most_elsewhere * len(unknown)
    found = [(localized(localizer, image, ranks), place) for image, place in known]
    right = [
        np.hypot(of.best.pose.x_m - place[0], of.best.pose.y_m - place[1]) < 10.0
        for of, place in found
        if of.localized
    ]
    assert all(right)
    assert len(right) >= least_found * len(known)


def test_signatures_that_cannot_tell_places_apart_are_refused_with_the_ranks_that_are_wanted(
    localizer, known
):
    image, _ = known[0]
    for ranks in ((2, 2), (2, 7), (6, 2), (1, 1)):
        with pytest.raises(InvalidSignature, match="wanted 6 x 7, or at least 3 x 3"):
            localized(localizer, image, ranks)


def test_all_numbers_that_a_map_keeps_count_as_its_own_queries_do(localizer, known):
    image, _ = known[3]
    for ranks in ((6, 7), (10, 12)):
        search = localizer.search(localizer.basis.encode(image, ranks))
        assert localizer.map.calibration_of(search) is localizer.map.calibration
    fewer = localizer.search(localizer.basis.encode(image, (5, 5)))
    assert localizer.map.calibration_of(fewer) != localizer.map.calibration
    assert localizer.map.rescaling_of(fewer) is localizer.map.rescaling_of(fewer)
