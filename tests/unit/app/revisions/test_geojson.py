"""Maps as GeoJSON: lines end where the path in between is not known, and at 180 degrees."""

from dataclasses import replace

import numpy as np
import pytest

from app.revisions.geojson import features_of
from core.mapping.anchor import Anchor
from core.mapping.georeference import Georeference
from tests.support.samples import sample_map, without_poses

METRE_DEG = 360.0 / 40_075_016.7  # of longitude, on the equator


def lines(x_m, longitude_deg=8.4, unknown=(), heading_deg=0.0):
    """Return the type of geometry, and the longitudes of lines, of a drive and of its edge."""
    tensor_map, _ = sample_map(len(x_m), len(x_m))
    poses = tensor_map.trajectory.poses.copy()
    poses[:, 0] = x_m
    moved = replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))
    features = features_of(
        without_poses(moved, *unknown),
        Georeference(Anchor(0.0, longitude_deg, heading_deg=heading_deg), ()),
    )
    found = {}
    for feature in features:
        geometry = feature["geometry"]
        of_lines = geometry["coordinates"]
        if geometry["type"] == "LineString":
            of_lines = [of_lines]
        if feature["properties"]["kind"] != "node":
            assert all(len(line) > 1 for line in of_lines)
            longitudes = [[position[0] for position in line] for line in of_lines]
            found[feature["properties"]["kind"]] = (geometry["type"], longitudes)
    return found


def test_a_street_without_a_gap_is_one_line():
    found = lines(np.arange(12.0))
    assert found["edge"] == ("LineString", found["drive"][1])
    assert [len(line) for line in found["drive"][1]] == [12]


def test_streets_are_not_drawn_across_gaps_and_unknown_poses():
    x_m = np.arange(12.0) + 500.0 * (np.arange(12) >= 4)
    found = lines(x_m, unknown=(7, 8))
    assert [len(line) for line in found["drive"][1]] == [4, 3, 3]
    assert found["edge"] == ("MultiLineString", found["drive"][1])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_lines_are_cut_where_they_cross_180_degrees_of_longitude(sign):
    x_m = sign * 10.0 * np.arange(4)
    found = lines(x_m, longitude_deg=sign * (180.0 - 15.0 * METRE_DEG))
    assert found["edge"][0] == "MultiLineString"
    for _, (here, there) in found.values():
        beyond = [sign * (180.0 - metres * METRE_DEG) for metres in (15.0, 5.0, 0.0)]
        assert here == pytest.approx(beyond, abs=2e-8)
        assert there == pytest.approx([-180.0 * sign, *(-value for value in beyond[1::-1])])
        assert (here[-1], there[0]) == (180.0 * sign, -180.0 * sign)


def test_a_line_that_begins_ends_or_runs_on_that_meridian_is_cut_only_where_it_leaves_it():
    step = 10.0 * METRE_DEG
    assert lines(10.0 * np.arange(4), 180.0)["drive"][1] == [
        pytest.approx([-180.0, -180.0 + step, -180.0 + 2 * step, -180.0 + 3 * step])
    ]
    assert lines(10.0 * np.arange(-3, 1), 180.0)["drive"][1] == [
        pytest.approx([180.0 - 3 * step, 180.0 - 2 * step, 180.0 - step, 180.0])
    ]
    across = lines(10.0 * np.arange(-2, 3), 180.0)["drive"][1]
    assert across == [
        pytest.approx([180.0 - 2 * step, 180.0 - step, 180.0]),
        pytest.approx([-180.0, -180.0 + step, -180.0 + 2 * step]),
    ]
    along = lines(10.0 * np.arange(9), 180.0, heading_deg=90.0)["drive"][1]
    assert [(len(line), {abs(longitude) for longitude in line}) for line in along] == [(9, {180.0})]


def test_the_crossing_is_interpolated():
    tensor_map, _ = sample_map(4, 4)
    poses = tensor_map.trajectory.poses.copy()
    poses[:, :3] = [[0.0, 0.0, 0.0], [10.0, 10.0, 4.0], [20.0, 20.0, 8.0], [30.0, 30.0, 12.0]]
    moved = replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))
    anchor = Anchor(-17.0, 180.0 - 15.0 * METRE_DEG / np.cos(np.radians(17.0)))
    drive, *_ = features_of(moved, Georeference(anchor, ()))
    here, there = drive["geometry"]["coordinates"]
    assert here[-1][1:] == there[0][1:]
    assert here[-1][2] == pytest.approx(6.0, abs=0.05)
    [wanted] = anchor.wgs84(np.array([[15.0, 15.0, 6.0]]))
    assert here[-1][1] == pytest.approx(wanted[0], abs=1e-6)
