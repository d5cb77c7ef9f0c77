"""Anchors: from the metres of a map to WGS84."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidMap, InvalidParameters
from core.mapping.anchor import Anchor, geocentric_m
from core.mapping.georeference import NOWHERE, Georeference
from core.mapping.placement import Placement
from core.scans.pose import Pose
from core.scans.rigid import RigidTransform

DRIVES = ("aside", "monday")
EAST_M = 111_319.490793  # of a degree of longitude on the equator: pi a / 180

anchors = st.builds(
    Anchor,
    latitude_deg=st.floats(-90, 90),
    longitude_deg=st.floats(-180, 180),
    altitude_m=st.floats(-500, 9000),
    heading_deg=st.floats(-360, 360),
    x_m=st.floats(-1e4, 1e4),
    y_m=st.floats(-1e4, 1e4),
)
points = st.lists(
    st.tuples(st.floats(-5e4, 5e4), st.floats(-5e4, 5e4), st.floats(-100, 1000)),
    min_size=2,
    max_size=5,
).map(np.array)


@given(anchors, points)
def test_distances_on_the_earth_are_those_of_the_map(anchor, points_m):
    on_earth = geocentric_m(anchor.wgs84(points_m))
    apart_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    assert np.linalg.norm(np.diff(on_earth, axis=0), axis=1) == pytest.approx(apart_m, abs=1e-6)


@given(anchors)
def test_the_anchored_point_is_at_the_anchor(anchor):
    at = anchor.wgs84(np.array([[anchor.x_m, anchor.y_m, anchor.z_m]]))
    there = np.array([[anchor.latitude_deg, anchor.longitude_deg, anchor.altitude_m]])
    assert geocentric_m(at) == pytest.approx(geocentric_m(there), abs=1e-6)


def test_a_degree_of_the_equator_and_a_known_place_in_paris():
    (there,) = Anchor(0.0, 0.0).wgs84(np.array([[EAST_M / 100.0, 0.0, 0.0]])).tolist()
    assert there[:2] == pytest.approx([0.0, 0.01], abs=1e-9)
    (paris,) = geocentric_m(np.array([[48.8562, 2.3508, 67.4]])).tolist()
    assert paris == pytest.approx([4_201_000.0, 172_460.0, 4_780_100.0], abs=60.0)


@pytest.mark.parametrize(
    ("heading_deg", "yaw_deg", "bearing_deg"),
    [(0.0, 0.0, 90.0), (0.0, 90.0, 0.0), (90.0, 0.0, 0.0), (-90.0, 0.0, 180.0), (30.0, 45.0, 15.0)],
)
def test_headings_become_bearings(heading_deg, yaw_deg, bearing_deg):
    anchor = Anchor(49.0, 8.4, 110.0, heading_deg)
    place = anchor.pose_wgs84(0.0, 0.0, 0.0, yaw_deg)
    assert place["bearing_deg"] == pytest.approx(bearing_deg, abs=1e-9)
    assert (place["latitude_deg"], place["altitude_m"]) == pytest.approx((49.0, 110.0), abs=1e-6)
    ahead = anchor.wgs84(np.array([[10.0, 0.0, 0.0]]))[0]
    north = heading_deg == 90.0
    assert (ahead[0] > 49.00008) == north


def test_a_bearing_a_hair_before_north_is_0_and_not_360():
    yaw_deg = math.nextafter(90.0, 180.0)
    assert Anchor(0.0, 0.0).pose_wgs84(0.0, 0.0, 0.0, yaw_deg)["bearing_deg"] == 0.0


def test_bearings_are_of_the_meridian_of_the_place():
    east = Anchor(60.0, 10.0).pose_wgs84(10_000.0, 0.0, 0.0, 90.0)
    turned_deg = (east["longitude_deg"] - 10.0) * np.sin(np.radians(60.0))
    assert (360.0 - east["bearing_deg"]) % 360.0 == pytest.approx(360.0 - turned_deg, abs=1e-3)


@pytest.mark.parametrize("wrong", [{"latitude_deg": 91.0}, {"heading_deg": float("nan")}])
def test_places_that_are_none_are_rejected(wrong):
    with pytest.raises(InvalidParameters, match=next(iter(wrong))):
        replace(Anchor(49.0, 8.4), **wrong)


def test_a_drive_beside_the_others_has_no_place_on_the_earth():
    georeference = Georeference(Anchor(49.0, 8.4), {"aside"})
    pose = Pose(1.0, 2.0, 3.0)
    known = {drive: "wgs84" in (georeference.pose(drive, pose) or {}) for drive in DRIVES}
    assert known == {"aside": False, "monday": True}
    assert not any("wgs84" in (NOWHERE.pose(drive, pose) or {}) for drive in DRIVES)
    assert georeference.pose("monday", None) is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"rotation": [0.0, 0.0, 0.0, 0.5]},
        {"matches": -1},
        {"spread_m": float("nan")},
        {"others": ["a\nb"]},
        {"unknown": 1},
    ],
)
def test_a_placement_that_is_none_is_no_map(wrong):
    values = Placement.of(RigidTransform(np.eye(3), np.zeros(3))).as_attributes()
    assert Placement.from_attributes(values).as_attributes() == values
    with pytest.raises(InvalidMap, match="placement"):
        Placement.from_attributes({**values, **wrong})
