"""What distances by fewer numbers mean is measured once, and no short work waits for it."""

from dataclasses import replace
from functools import partial

import pytest

from app.loading import NotLoaded, without_loading
from app.localization.limited_queries import require_measured
from core.encodings.search import QueryLimits
from core.errors import InvalidSignature
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.projection.visibility import FULL_VIEW
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

FIVE = QueryLimits((5, 5), FULL_VIEW)


@pytest.fixture(scope="module")
def localizer():
    drive = SimulatedDrive(seed=5, scans=40, sensor=SimulatedSensor(firings=360))
    return Localizer(build_map(drive, MapParameters.for_sensor()))


def signatures(localizer, ranks):
    [own] = localizer.map.model.own_queries([7], localizer.map.revision)
    return [replace(one, values=one.values[: ranks[0], : ranks[1]]) for one in own]


def test_short_work_names_what_has_to_be_measured_and_finds_it_measured_then(localizer):
    work = partial(require_measured, localizer, signatures(localizer, (5, 5)))
    needed = without_loading(work)
    assert isinstance(needed, NotLoaded)
    assert localizer.map.rescalings.known(FIVE) is None
    assert needed.load() is localizer.map.rescalings.known(FIVE)
    assert localizer.map.rescalings.known(FIVE) is not None
    assert without_loading(work) is None


def test_signatures_of_all_numbers_need_no_measurement_and_those_of_one_shape_share_it(localizer):
    require_measured(localizer, signatures(localizer, (4, 7)))
    for ranks in ((6, 7), (4, 4), (6, 4), (4, 6)):
        work = partial(require_measured, localizer, signatures(localizer, ranks))
        assert without_loading(work) is None


def test_signatures_of_too_few_numbers_are_refused_with_the_ranks_that_were_sent(localizer):
    for r1, r2 in ((2, 5), (5, 2), (1, 7)):
        wanted = f"has {r1} x {r2} numbers, .* wanted 6 x 7, or at least 3 x 3$"
        with pytest.raises(InvalidSignature, match=wanted):
            without_loading(partial(require_measured, localizer, signatures(localizer, (r1, r2))))
