"""Maps as GeoJSON: lines end where the path in between is not known."""

from dataclasses import replace

import numpy as np

from app.revisions.geojson import features_of
from core.mapping.anchor import Anchor
from core.mapping.georeference import Georeference
from tests.support.samples import sample_map, without_poses


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
