"""The belief before an observation, also where the last one is long ago or far away."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.prediction import LONGEST_SHARE, predicted
from tests.support.beliefs import belief_of_all
from tests.support.samples import sample_map, straight_poses, trajectory

MOTION = Motion()


@pytest.fixture(scope="module")
def graph():
    """Of one drive of 400 scans, a metre apart."""
    return TravelGraph.of_map(sample_map(count=400, segment_length=400)[0])


def belief_at(graph, row, pace=1.0):
    """Return the belief of a vehicle that is nearly certainly there, at that pace."""
    at = np.full((graph.places, len(MOTION.pace)), 1e-9)
    at[2 * row, MOTION.pace == pace] = 1.0
    return belief_of_all(at / at.sum(), 0.0)


@pytest.mark.parametrize("travelled_m", [3.0, 23.0, 25.0, 54.0, 150.0, -40.0, -120.0])
def test_odometry_leads_as_far_as_the_vehicle_drove(graph, travelled_m):
    belief = predicted(belief_at(graph, 200), graph, MOTION, 1.0, travelled_m)
    assert belief is not None
    of_scan = belief.of_scan
    reached = 200 + round(travelled_m)
    spread = 2.0 * (0.5 + 0.1 * abs(travelled_m))
    near = np.abs(np.arange(len(graph)) - reached) <= spread
    assert of_scan[near].sum() > 0.9
    assert abs(int(of_scan.argmax()) - reached) <= max(1.0, 0.03 * abs(travelled_m))


@pytest.mark.parametrize("step_m", [0.05, 0.1, 0.2, 0.34])
@pytest.mark.parametrize("travelled_m", [1.0, 3.0, -6.0, 8.0])
def test_odometry_leads_as_far_among_scans_that_were_recorded_at_walking_pace(step_m, travelled_m):
    dense = TravelGraph.of_map(sample_map(400, 400, step_m=step_m)[0])
    belief = predicted(belief_at(dense, 200), dense, MOTION, 1.0, travelled_m)
    assert belief is not None
    sigma_m = 0.5 + 0.1 * abs(travelled_m)
    along_m = (np.arange(400) - 200) * step_m
    mean_m = belief.of_scan @ along_m
    assert abs(mean_m - travelled_m) < 0.5 * sigma_m
    assert belief.of_scan @ (along_m - mean_m) ** 2 < (1.5 * sigma_m) ** 2


@pytest.mark.parametrize("travelled_m", [10.0, 25.0, 54.0, 150.0])
def test_the_spread_of_odometry_is_of_the_whole_way_in_however_many_parts_it_is_predicted(
    graph, travelled_m
):
    belief = predicted(belief_at(graph, 100), graph, MOTION, 1.0, travelled_m)
    assert belief is not None
    of_scan, along_m = belief.of_scan, np.arange(len(graph)) - 100.0
    sigma_m = 0.5 + 0.1 * travelled_m
    likely = np.abs(along_m - travelled_m) < 5.0 * sigma_m
    mean_m = np.average(along_m[likely], weights=of_scan[likely])
    spread_m = np.sqrt(np.average((along_m[likely] - mean_m) ** 2, weights=of_scan[likely]))
    assert spread_m == pytest.approx(sigma_m, rel=0.2)


@pytest.mark.parametrize(("pace", "share"), [(1.0, 10.0), (4.0, 8.0), (16.0, 2.0), (16.0, 9.0)])
def test_a_pace_leads_as_far_as_the_vehicle_went_in_that_time(graph, pace, share):
    belief = predicted(belief_at(graph, 100, pace), graph, MOTION, share, None)
    assert belief is not None
    assert abs(int(belief.of_scan.argmax()) - (100 + pace * share)) <= 0.1 * pace * share


def test_a_pace_says_nothing_of_a_gap_and_odometry_does(graph):
    share = LONGEST_SHARE + 0.1
    assert predicted(belief_at(graph, 100), graph, MOTION, share, None) is None
    assert predicted(belief_at(graph, 100), graph, MOTION, share, 12.0) is not None


def test_odometry_says_nothing_of_a_map_without_poses():
    unposed = TravelGraph.of_map(sample_map(count=60, segment_length=60, poses=False)[0])
    assert predicted(belief_at(unposed, 20), unposed, MOTION, LONGEST_SHARE + 0.1, 12.0) is None


@pytest.mark.parametrize("travelled_m", [400.0, -1e6])
def test_of_a_way_of_hundreds_of_scans_nothing_is_known(graph, travelled_m):
    assert predicted(belief_at(graph, 10), graph, MOTION, 1.0, travelled_m) is None


@pytest.mark.parametrize("travelled_m", [1.0, 30.0])
def test_a_vehicle_at_the_end_of_the_map_stays_there(graph, travelled_m):
    belief = predicted(belief_at(graph, 398), graph, MOTION, 1.0, travelled_m)
    assert belief is not None
    assert int(belief.of_scan.argmax()) == 399


@pytest.mark.parametrize(("travelled_m", "parts"), [(1.0, 1), (4.0, 1), (10.0, 2), (30.0, 6)])
@pytest.mark.parametrize("step_m", [0.1, 0.34, 1.0])
def test_behind_the_end_of_a_drive_a_way_is_not_predicted_in_more_parts_than_among_near_scans(
    travelled_m, parts, step_m
):
    graph = TravelGraph.of_map(sample_map(count=400, segment_length=400, step_m=step_m)[0])
    at_end = belief_at(graph, 399)
    with patch.object(Belief, "predicted", autospec=True, side_effect=Belief.predicted) as made:
        belief = predicted(at_end, graph, MOTION, 1.0, travelled_m)
    assert made.call_count <= parts
    assert belief is not None
    assert int(belief.of_scan.argmax()) == 399


@pytest.fixture(scope="module")
def with_a_stand():
    """Of one drive of 20 m, 560 scans of a stand and 20 m more."""
    poses = straight_poses(600)
    poses[:, 0] = [*range(20), *[20.0] * 560, *range(21, 41)]
    mapped, _ = sample_map(count=600, segment_length=600)
    return TravelGraph.of_map(replace(mapped, trajectory=trajectory(poses)))


@pytest.mark.parametrize("travelled_m", [3.0, 12.0, 30.0, -9.0])
def test_odometry_leads_out_of_a_stand_as_far_as_the_vehicle_drove(with_a_stand, travelled_m):
    moved = predicted(belief_at(with_a_stand, 100), with_a_stand, MOTION, 1.0, travelled_m)
    assert moved is not None
    reached = 579 + travelled_m if travelled_m > 0.0 else 20 + travelled_m
    assert abs(int(moved.of_scan.argmax()) - min(reached, 599)) <= 1


def test_a_vehicle_with_a_pace_leaves_a_stand_and_one_without_is_in_it(with_a_stand):
    moved = predicted(belief_at(with_a_stand, 100, pace=4.0), with_a_stand, MOTION, 1.0, None)
    assert moved is not None
    assert moved.of_scan[581:586].sum() > 0.9
    stays = predicted(belief_at(with_a_stand, 100, pace=0.0), with_a_stand, MOTION, 1.0, None)
    assert stays is not None
    assert stays.of_scan[100] > 0.9
