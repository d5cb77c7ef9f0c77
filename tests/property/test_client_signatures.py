"""A client's signature of any scan is that of the service, to the byte."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tensormap_client import Mounting, Tilt, UnusableScan

from core.encodings.signature import pack_signatures
from core.errors import InvalidScan
from core.scans import mounting as service_mounting
from core.scans.scan import Scan
from core.scans.tilt import Tilt as ServiceTilt
from tests.support.client_bases import PARAMETERS, all_numbers, as_downloaded, basis_of

BASES = {name: basis_of(parameters) for name, parameters in PARAMETERS.items()}
CLIENT_BASES = {name: as_downloaded(basis) for name, basis in BASES.items()}
NO_RETURNS = np.array([[np.nan, 1.0, 1.0], [0.0, 0.0, 0.0], [np.inf, 0.0, 0.0], [-0.0, 0.0, -0.0]])


@st.composite
def scans(draw):
    """Rough ground that is tilted, walls with gaps, a truck, ties of angles, and no returns."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    slope = rng.uniform(-0.2, 0.2, 2) * draw(st.sampled_from([0.0, 0.3, 1.0]))
    reach_m = draw(st.sampled_from([12.0, 35.0, 90.0]))
    ground = rng.uniform(-reach_m, reach_m, (draw(st.sampled_from([0, 40, 3000])), 2))
    depth_m = rng.uniform(0.9, 2.4)
    height = (
        ground @ slope - depth_m + rng.normal(0.0, draw(st.sampled_from([0.0, 0.05])), len(ground))
    )
    count = draw(st.sampled_from([0, 1, 800]))
    azimuth = np.radians(rng.uniform(-180.0, draw(st.sampled_from([-60.0, 180.0])), count))
    if draw(st.booleans()):
        azimuth = np.radians(rng.integers(-360, 361, count) / 2.0)  # ties of whole degrees
    far_m = rng.uniform(2.0, reach_m, count)
    walls = np.stack(
        [far_m * np.cos(azimuth), far_m * np.sin(azimuth), rng.uniform(-2.0, 9.0, count)], axis=1
    )
    points = np.concatenate([np.column_stack([ground, height]), walls, NO_RETURNS])
    return rng.permutation(points).astype(draw(st.sampled_from([np.float32, np.float64])))


def of_service(basis, points, height_m=None, mounting=None, tilt=None):
    """Return the bytes of the service, `None` where it rejects the scan."""
    try:
        scan = Scan.from_returns(points)
        if mounting is not None:
            scan = mounting.mount(scan, basis.parameters.sensor_height_m)
        if tilt is not None:
            scan = tilt.level(scan)
        return pack_signatures(basis.encode(basis.image(scan, height_m)))
    except InvalidScan:
        return None


def of_client(basis, points, **options):
    try:
        return basis.encode(points, **options)
    except UnusableScan:
        return None


@pytest.mark.parametrize("name", PARAMETERS)
@settings(max_examples=12, deadline=None)
@given(points=scans(), height_m=st.sampled_from([None, 1.2]))
def test_it_is_that_of_the_service_in_maps_of_every_kind(name, points, height_m):
    mine = of_client(CLIENT_BASES[name], points, sensor_height_m=height_m)
    assert mine == of_service(BASES[name], points, height_m)


@pytest.mark.parametrize("name", ["default", "default, mean", "any, 5 x 5"])
@settings(max_examples=12, deadline=None)
@given(points=scans())
def test_with_all_numbers_it_is_that_of_the_core(name, points):
    mine = of_client(CLIENT_BASES[name], points, all_numbers=True)
    try:
        image = BASES[name].image(Scan.from_returns(points))
    except InvalidScan:
        assert mine is None
        return
    assert mine == all_numbers(BASES[name], image)


@settings(max_examples=10, deadline=None)
@given(
    points=scans(),
    angles_deg=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
    known=st.booleans(),
)
def test_mountings_and_gravity_turn_a_scan_as_the_service_does(points, angles_deg, known):
    roll_deg, pitch_deg, yaw_deg = angles_deg
    place = (1.0, -0.5, 1.9, roll_deg / 4, pitch_deg / 4, yaw_deg)
    tilt = (roll_deg, pitch_deg) if known else None
    mine = of_client(
        CLIENT_BASES["default"],
        points,
        mounting=Mounting(*place),
        tilt=None if tilt is None else Tilt(*tilt),
    )
    theirs = of_service(
        BASES["default"],
        points,
        mounting=service_mounting.Mounting(*place),
        tilt=None if tilt is None else ServiceTilt(*tilt),
    )
    # A rotation is rounded otherwise, so that a return may be in the next cell.
    assert (mine is None) == (theirs is None)
    if mine is not None and mine[:19] == theirs[:19] and len(mine) == len(theirs):
        one, other = (np.frombuffer(some[25:], np.int8).astype(int) for some in (mine, theirs))
        assert np.abs(one - other).mean() <= 1.0
