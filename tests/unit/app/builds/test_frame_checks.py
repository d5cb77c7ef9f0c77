"""Drives whose poses were confirmed to be in one frame are not matched again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.builds.frame_checks import require_frames
from core.errors import FramesDisagree
from core.parameters import MapParameters
from core.progress import NO_PROGRESS
from tests.support.passes import map_of, moved, unchanged

pytestmark = pytest.mark.slow

OTHER_FRAME = moved(500.0, Rotation.from_euler("z", 30.0, degrees=True))


class Matched:
    """The number of scans that are matched."""

    def __init__(self):
        self.scans = 0

    def start(self, stage, total):
        self.scans += total

    def advance(self, units=1):
        pass


def checked(confirmed, **places):
    """Return how many scans were matched, and the drives that are confirmed then."""
    matched = Matched()
    parameters = MapParameters.for_sensor(encoding="harmonic")
    _, found = require_frames(map_of(parameters, **places), (), confirmed, matched)
    return matched.scans, found


@pytest.fixture(scope="module")
def two():
    return checked({}, monday=unchanged, tuesday=unchanged)


def test_drives_that_meet_are_confirmed_by_their_poses(two):
    matched, confirmed = two
    assert matched > 20
    assert list(confirmed) == ["monday", "tuesday"]


def test_with_the_same_poses_they_are_not_matched_again(two):
    _, confirmed = two
    assert checked(confirmed, monday=unchanged, tuesday=unchanged) == (0, confirmed)
    # Without one of them the other is still where it was.
    assert checked(confirmed, tuesday=unchanged) == (0, {"tuesday": confirmed["tuesday"]})


@pytest.mark.parametrize("order", [("monday", "tuesday", "back"), ("back", "monday", "tuesday")])
def test_only_a_drive_that_is_new_is_matched_wherever_it_is_among_them(two, order):
    matched, confirmed = two
    again, found = checked(confirmed, **dict.fromkeys(order, unchanged))
    assert 20 < again < 1.5 * matched
    assert set(found) == set(order)
    places = {name: OTHER_FRAME if name == "back" else unchanged for name in order}
    with pytest.raises(FramesDisagree, match="drive back"):
        checked(confirmed, **places)


@pytest.mark.parametrize("name", ["monday", "tuesday"])
def test_a_drive_that_got_other_poses_is_matched_again(two, name):
    _, confirmed = two
    places = {"monday": unchanged, "tuesday": unchanged, name: OTHER_FRAME}
    with pytest.raises(FramesDisagree, match=f"drive {name}"):
        checked(confirmed, **places)


def test_a_drive_that_never_met_the_others_is_matched_each_time(two):
    places = {"monday": unchanged, "elsewhere": moved(1000.0)}
    first, confirmed = checked({}, **places)
    assert list(confirmed) == ["monday"]
    assert checked(confirmed, **places) == (first, confirmed)


def test_a_drive_whose_poses_are_odometry_is_not_confirmed():
    parameters = MapParameters.for_sensor(encoding="harmonic")
    tensor_map = map_of(parameters, monday=unchanged, tuesday=unchanged)
    _, confirmed = require_frames(tensor_map, ["tuesday"], {}, NO_PROGRESS)
    assert list(confirmed) == ["monday"]


def test_one_pose_more_is_another_digest(two):
    _, confirmed = two
    parameters = MapParameters.for_sensor(encoding="harmonic")
    tensor_map = map_of(parameters, monday=unchanged, tuesday=unchanged)
    trajectory = tensor_map.trajectory
    poses = trajectory.poses.copy()
    poses[-1] = np.nan
    without = replace(tensor_map, trajectory=replace(trajectory, poses=poses))
    _, found = require_frames(without, (), confirmed, NO_PROGRESS)
    assert found["monday"] == confirmed["monday"]
    assert found["tuesday"] != confirmed["tuesday"]
