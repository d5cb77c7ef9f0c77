"""SOLiD by hand."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.roster import methods_named
from baselines.solid import Solid
from core.errors import InvalidParameters, InvalidScan
from core.scans.scan import Scan

# Two ranges of 10 m, four azimuths of a quarter turn, three elevations of 10 degrees.
SMALL = Solid(2, 4, 3, 20.0, elevation_min_deg=-15.0, elevation_max_deg=15.0, voxel_m=0.0)


def at(range_m, azimuth_deg, elevation_deg):
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    x, y = range_m * np.cos(azimuth), range_m * np.sin(azimuth)
    return [x, y, range_m * np.tan(elevation)]


def test_counts_are_weighted_by_how_many_returns_an_elevation_holds():
    returns = [
        at(5, 10, -10), at(5, 100, 0), at(5, 100, 1), at(5, 190, 0), at(15, 190, 2),
        at(15, 280, 10), at(15, 280, 11), at(25, 10, 0), at(5, 10, 40),
    ]  # fmt: skip
    # Elevations hold 1, 4 and 2 returns: the weights are 0, 1 and 1/3.
    # Ranges hold (1, 3, 0) and (0, 1, 2); azimuths (1, 0, 0), (0, 2, 0), (0, 2, 0), (0, 0, 2).
    described = SMALL.describe(Scan(np.array(returns)))
    expected = [3.0, 1.0 + 2.0 / 3.0, 0.0, 2.0, 2.0, 2.0 / 3.0]
    np.testing.assert_allclose(described, expected, rtol=1e-6)


def test_elevations_that_hold_as_many_all_count():
    returns = [at(5, 10, -10), at(15, 100, 0), at(15, 190, 10)]
    described = SMALL.describe(Scan(np.array(returns)))
    np.testing.assert_allclose(described, [1, 2, 1, 1, 1, 0])


def test_returns_are_thinned_to_one_in_each_cube():
    crowd = [[5.1 + 0.01 * i, 0.1, 0.0] for i in range(9)]
    thinned = Solid(voxel_m=0.5).describe(Scan(np.array(crowd)))
    alone = Solid(voxel_m=0.5).describe(Scan(np.array([[5.14, 0.1, 0.0]])))
    np.testing.assert_array_equal(thinned, alone)


def test_places_are_compared_by_the_cosine_of_their_ranges():
    descriptors = np.array([[1, 0, 9, 0, 0, 0], [1, 1, 0, 9, 0, 0]], np.float32)
    found = SMALL.places(descriptors).nearest(np.array([3, 2, 0, 0, 9, 0], np.float32))
    assert found is not None
    assert found.row == 1
    assert found.distance == pytest.approx(1.0 - 5.0 / np.sqrt(2.0 * 13.0))
    # What the query sees at its azimuth 2 the place saw at 1: its relative yaw is -90 degrees.
    assert found.relative_yaw_deg == -90.0


def test_returns_outside_the_elevations_are_in_the_edge_bins_where_they_are_clamped():
    clamped = replace(SMALL, clamped=True)
    outside = [at(5, 10, -60), at(5, 100, 0), at(5, 100, 1), at(15, 190, 40)]
    edges = [at(5, 10, -14), at(5, 100, 0), at(5, 100, 1), at(15, 190, 14)]
    found = clamped.describe(Scan(np.array(outside)))
    np.testing.assert_array_equal(found, SMALL.describe(Scan(np.array(edges))))


def test_returns_that_are_too_near_are_left_out():
    far = replace(SMALL, min_range_m=3.0)
    near, others = [at(1, 10, 0), at(2.9, 100, 0)], [at(3.1, 10, 0), at(15, 190, 10)]
    found = far.describe(Scan(np.array(near + others)))
    np.testing.assert_array_equal(found, SMALL.describe(Scan(np.array(others))))
    with pytest.raises(InvalidScan, match="none of the 2 returns is 3 m away or more"):
        far.describe(Scan(np.array(near)))


def test_an_hdl_64e_has_the_profile_that_the_authors_publish():
    [solid] = methods_named(["solid"], sensor="hdl-64e", sensor_height_m=1.73, segment_length=9)
    assert solid == Solid(
        elevations=32, voxel_m=0.4, min_range_m=3.0, elevation_min_deg=-24.8,
        elevation_max_deg=2.0, clamped=True,
    )  # fmt: skip


def test_nothing_within_the_elevations_is_no_place():
    with pytest.raises(InvalidScan, match="deg of elevation"):
        SMALL.describe(Scan(np.array([at(5, 0, 40)])))


@pytest.mark.parametrize(
    "wrong",
    [
        {"ranges": 0},
        {"reach_m": np.inf},
        {"voxel_m": -1.0},
        {"elevation_min_deg": 5.0, "elevation_max_deg": 5.0},
        {"elevation_max_deg": 91.0},
    ],
)
def test_invalid_values_are_rejected(wrong):
    with pytest.raises(InvalidParameters):
        Solid(**wrong)
