"""Queries cast anywhere between two scans of a simulated street are placed there."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.localization.localizer import Localizer
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.projection.imager import Views
from core.scans.displacement import pose_beside
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.simulation import SimulatedDrive
from core.simulation.raycast import cast

STREET = SimulatedDrive(seed=9, scans=8, speed_m_s=36.0, stops=False)
"""On a straight, scans 3.6 m apart."""


@cache
def _localizer(views: Views, ranks: tuple[int, int]) -> Localizer:
    mapped = MemoryDrive(STREET.name, list(STREET))
    parameters = MapParameters.for_sensor(ranks=ranks, views=views)
    return Localizer(build([mapped], parameters, calibrated=False).tensor_map)


@pytest.mark.parametrize(
    ("views", "ranks"), [(Views.FULL, (5, 5)), (Views.ANY, (5, 5)), (Views.ANY, (5, 8))]
)
@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(
    before=st.integers(0, 6),
    share=st.floats(0.0, 1.0),
    left_m=st.floats(-3.0, 3.0),
    turn_deg=st.floats(-180.0, 180.0),
)
def test_a_query_between_two_scans_is_placed_within_a_metre_and_a_half(
    views, ranks, before, share, left_m, turn_deg
):
    ahead_m = share * float(np.linalg.norm(STREET.poses[before + 1, :3] - STREET.poses[before, :3]))
    true = pose_beside(STREET.poses[before], left_m, turn_deg, ahead_m)
    rng = np.random.default_rng(1)
    scan = cast(STREET.world.at(0.3), Pose(*true.tolist()), STREET.sensor, rng, timestamp_s=0.0)
    found = _localizer(views, ranks).localize_scan(scan).best.estimated_pose
    assert found is not None
    assert np.hypot(found.x_m - true[0], found.y_m - true[1]) <= 1.5
