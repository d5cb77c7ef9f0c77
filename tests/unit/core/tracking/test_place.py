"""The most likely place of a belief."""

from dataclasses import replace

import numpy as np
import pytest

from core.arrays import FloatArray
from core.mapping.tensormap import TensorMap
from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.place import Place
from tests.support.beliefs import belief_of_all
from tests.support.samples import sample_map


def most_likely(belief: Belief, mapped: TensorMap) -> Place:
    return Place.most_likely(belief, mapped, TravelGraph.of_map(mapped))


def map_with_scans_apart(metres: float) -> TensorMap:
    tensor_map, _ = sample_map(count=60, segment_length=20)
    poses = tensor_map.trajectory.poses.copy()
    poses[:, :3] = 0.0
    poses[:, 0] = metres * np.arange(len(poses))
    return replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))


def map_with_a_stand() -> TensorMap:
    """Return one of 20 m, 20 scans of a stand and 20 m more."""
    mapped = map_with_scans_apart(1.0)
    poses = mapped.trajectory.poses.copy()
    poses[:, 0] = np.concatenate([np.arange(20.0), np.full(20, 20.0), np.arange(21.0, 41.0)])
    return replace(mapped, trajectory=replace(mapped.trajectory, poses=poses))


def of_two_drives(tensor_map: TensorMap, poses: FloatArray) -> TensorMap:
    trajectory = replace(
        tensor_map.trajectory,
        poses=poses,
        drives=("monday", "tuesday"),
        drive_start=np.array([0, 40, 60]),
    )
    return replace(tensor_map, trajectory=trajectory)


@pytest.mark.parametrize("metres", [0.5, 2.4, 2.6, 5.1, 20.0])
@pytest.mark.parametrize("tail", [-1, 0, 1])
def test_a_belief_in_one_scan_is_a_place_at_that_scan_however_far_apart_scans_are(metres, tail):
    mapped = map_with_scans_apart(metres)
    at = np.full((2 * len(mapped), len(Motion().pace)), 1e-9)
    at[2 * 20] = 1.0
    at[2 * (20 + 3 * tail)] += 1e-6  # a little more of it is on one side
    place = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert place.probability > 0.99
    assert place.position == pytest.approx(20.0, abs=0.01)


@pytest.mark.parametrize("scans", [1, 2, 3, 4, 5, 6])
def test_a_belief_in_one_scan_of_a_short_map_is_a_place_at_that_scan(scans):
    mapped, _ = sample_map(count=scans, segment_length=scans, step_m=20.0)
    for row in range(scans):
        at = np.full((2 * scans, len(Motion().pace)), 1e-9)
        at[2 * row] = 1.0
        place = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
        assert place.position == pytest.approx(row, abs=0.01)


@pytest.mark.parametrize("scans", [2, 3, 4, 5])
def test_in_a_map_of_a_few_scans_the_place_is_the_same_from_either_end(scans):
    mapped, _ = sample_map(count=scans, segment_length=scans, step_m=3.0)
    weights = np.array([2.0, 1.0, 1.0, 1.0, 1.0])[:scans, None] * np.ones(2 * len(Motion().pace))
    there, back = (
        most_likely(belief_of_all((one / one.sum()).reshape(2 * scans, -1), 0.0), mapped)
        for one in (weights, weights[::-1])
    )
    assert there.probability == pytest.approx(back.probability, abs=1e-6)
    assert there.position == pytest.approx(scans - 1 - back.position, abs=1e-6)


def test_a_place_where_the_mapping_vehicle_crept_is_the_mean_of_its_belief():
    mapped = map_with_scans_apart(0.05)
    rows = np.arange(len(mapped))
    at = np.zeros((2 * len(mapped), len(Motion().pace)))
    at[::2, 1] = np.exp(-0.5 * ((rows - 30.0) / 12.0) ** 2)
    at /= at.sum()
    place = most_likely(belief_of_all(at, 0.0), mapped)
    stand_m = 0.05 * 9
    mean = float(at[::2, 1] @ rows)
    assert place.position == pytest.approx(mean, abs=0.1)
    sigma_m = 0.05 * float(np.sqrt(at[::2, 1] @ (rows - mean) ** 2))
    assert stand_m * place.sigma == pytest.approx(sigma_m, rel=0.1)


def test_a_place_with_a_stand_is_the_mean_of_it_as_one_scan_and_of_those_beside_it():
    mapped = map_with_a_stand()
    at = np.zeros((2 * len(mapped), len(Motion().pace)))
    at[2 * np.arange(20, 40), 1] = 0.3 / 20
    at[[2 * 40, 2 * 41], 1] = 0.5, 0.2
    place = most_likely(belief_of_all(at, 0.0), mapped)
    assert place.position == pytest.approx(39.9)
    assert place.sigma == pytest.approx(np.sqrt(0.3 * 0.81 + 0.5 * 0.01 + 0.2 * 1.21))
    assert place.beyond(25) == pytest.approx((0.0, 0.7))
    at[2 * 41, 1], at[2 * 20, 1] = 0.0, 0.3 / 20 + 0.2
    assert most_likely(belief_of_all(at, 0.0), mapped).position == pytest.approx(39.5)


@pytest.mark.parametrize("metres", [0.1, 0.5, 1.0])
def test_a_place_has_the_spread_of_its_belief_however_near_scans_are(metres):
    mapped = map_with_scans_apart(metres)
    spread = 0.8 / metres
    of_scan = np.exp(-0.5 * ((np.arange(len(mapped)) - 30.0) / spread) ** 2)
    at = np.zeros((2 * len(mapped), len(Motion().pace)))
    at[::2, 1] = of_scan / of_scan.sum()
    place = most_likely(belief_of_all(at, 0.0), mapped)
    rows = np.arange(len(mapped))
    mean = float(at[::2, 1] @ rows)  # of those that the map has
    assert place.position == pytest.approx(mean, abs=0.1)
    assert place.sigma == pytest.approx(float(np.sqrt(at[::2, 1] @ (rows - mean) ** 2)), rel=0.05)


def test_a_place_where_the_mapping_vehicle_stood_has_the_scans_before_and_after():
    mapped = map_with_a_stand()
    at = np.zeros((2 * len(mapped), len(Motion().pace)))
    at[2 * 30, 1], at[2 * 42, 1] = 0.5, 0.5  # at the stop, and 3 m after it
    place = most_likely(belief_of_all(at, 0.0), mapped)
    along_m = mapped.trajectory.poses[place.rows, 0]
    mean_m = place.weight @ along_m
    assert place.weight @ (along_m - mean_m) ** 2 == pytest.approx(1.5**2)


@pytest.mark.parametrize("before_the_turn", [20, 8])
def test_the_way_back_through_a_place_is_not_averaged_with_the_way_there(before_the_turn):
    mapped = map_with_scans_apart(0.5)
    poses = mapped.trajectory.poses.copy()
    poses[30:, 0], poses[30:, 1] = poses[29::-1, 0], 3.0
    poses[:, 3:] = [0.0, 0.0, 0.0, 1.0]
    poses[30:, 3:] = [0.0, 0.0, 1.0, 0.0]
    mapped = replace(mapped, trajectory=replace(mapped.trajectory, poses=poses))
    there, back = 29 - before_the_turn, 30 + before_the_turn
    at = np.zeros((2 * len(mapped), len(Motion().pace)))
    at[2 * there, 1], at[2 * back, 1] = 0.6, 0.4
    place = most_likely(belief_of_all(at, 0.0), mapped)
    assert place.probability == pytest.approx(1.0)
    assert (place.position, place.sigma) == (there, 0.0)


@pytest.mark.parametrize(
    ("metres", "probability"), [(4.0, 1.0), (7.0, 1.0), (9.9, 1.0), (10.1, 0.55)]
)
def test_between_two_scans_up_to_ten_metres_apart_a_vehicle_is_in_one_place(metres, probability):
    mapped = map_with_scans_apart(metres)
    at = np.full((2 * len(mapped), len(Motion().pace)), 1e-9)
    at[2 * 20, 1], at[2 * 21, 1] = 0.55, 0.45
    place = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert place.position == pytest.approx(20.45, abs=0.01)
    assert place.probability == pytest.approx(probability, abs=0.01)


@pytest.mark.parametrize(("apart_m", "probability"), [(4.0, 1.0), (9.0, 0.55)])
def test_a_scan_of_another_drive_is_in_the_place_if_it_is_no_farther_than_those_beside_it(
    apart_m, probability
):
    mapped = map_with_scans_apart(7.0)
    poses = mapped.trajectory.poses.copy()
    poses[40:, 0], poses[40:, 1] = poses[10:30, 0], apart_m
    mapped = of_two_drives(mapped, poses)
    at = np.full((2 * len(mapped), len(Motion().pace)), 1e-9)
    at[2 * 20, 1], at[2 * 50, 1] = 0.55, 0.45
    place = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert place.position == pytest.approx(20.0, abs=0.01)
    assert place.probability == pytest.approx(probability, abs=0.01)


def test_a_place_at_the_end_of_a_drive_does_not_reach_into_the_next_one():
    mapped = map_with_scans_apart(1.0)
    poses = mapped.trajectory.poses.copy()
    poses[40:, 0] += 8.0
    mapped = of_two_drives(mapped, poses)
    at = np.full((2 * len(mapped), len(Motion().pace)), 1e-9)
    at[2 * 39, 1], at[2 * 40, 1] = 0.55, 0.45
    place = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert place.probability == pytest.approx(0.55, abs=0.01)


def test_of_a_belief_in_neighbouring_scans_and_one_scan_elsewhere_the_neighbours_are_the_place():
    mapped = map_with_scans_apart(1.0)
    at = np.full((2 * len(mapped), len(Motion().pace)), 1e-9)
    at[2 * 40, 1] = 0.3
    at[2 * np.arange(10, 13), 1] = 0.2, 0.29, 0.21
    place = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert place.position == pytest.approx(11.0, abs=0.1)
    assert place.probability == pytest.approx(0.7, abs=0.01)


def test_a_street_that_was_recorded_in_both_directions_is_passed_in_the_one_of_the_reported_scan():
    mapped = map_with_scans_apart(1.0)
    poses = mapped.trajectory.poses.copy()
    poses[30:, 0], poses[30:, 1] = poses[29::-1, 0], 1.0
    poses[30:, 3:] = 0.0, 0.0, 1.0, 0.0  # back, rotated by 180 degrees
    mapped = replace(mapped, trajectory=replace(mapped.trajectory, poses=poses))
    at = np.full((2 * len(mapped), len(Motion().pace)), 1e-9)
    at[2 * 10, 1], at[2 * 49 + 1, 1] = 0.5, 0.45  # scan 49 is beside scan 10
    there = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert there.position == pytest.approx(10.0, abs=0.01)
    assert there.along > 0.99
    at[2 * 10 : 2 * 10 + 2, 1], at[2 * 49 : 2 * 49 + 2, 1] = (0.0, 0.5), (0.45, 0.0)
    back = most_likely(belief_of_all(at / at.sum(), 0.0), mapped)
    assert back.position == pytest.approx(10.0, abs=0.01)
    assert back.along < 0.01


def test_a_stand_is_a_place_however_little_of_the_belief_is_in_each_of_its_scans():
    mapped = map_with_a_stand()
    at = np.zeros((2 * len(mapped), len(Motion().pace)))
    at[2 * np.arange(20, 40), 1] = 0.8 / 20
    at[2 * 55, 1] = 0.2
    place = most_likely(belief_of_all(at, 0.0), mapped)
    assert place.probability == pytest.approx(0.8)
    assert 19.9 <= place.position <= 39.1
