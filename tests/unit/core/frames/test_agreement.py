"""Drives in one world frame, and in several."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.encodings.registry import encoding_names
from core.errors import FramesDisagree
from core.frames.agreement import check_frames, require_one_frame
from core.frames.consensus import find_consensus
from core.parameters import MapParameters
from tests.support.passes import map_of, moved, passes, unchanged, unknown

pytestmark = pytest.mark.slow


class Stages:
    """Stores the reported progress."""

    def __init__(self):
        self.stages, self.units = [], 0

    def start(self, stage, total):
        self.stages.append((stage, total))

    def advance(self, units=1):
        self.units += units


@pytest.fixture(scope="module", params=encoding_names())
def parameters(request):
    return MapParameters.for_sensor(encoding=request.param)


def checked(parameters, progress=None, **places):
    """Build a map of drives, their poses changed, and check its frames."""
    tensor_map = map_of(parameters, **places)
    return check_frames(tensor_map) if progress is None else check_frames(tensor_map, progress)


@pytest.mark.parametrize("x_m", [0.0, 2.0])
def test_drives_of_one_frame_agree_although_they_drift_apart(parameters, x_m):
    (check,) = checked(parameters, monday=unchanged, tuesday=moved(x_m))
    assert check.met
    assert check.note is None
    require_one_frame([check])


@pytest.mark.parametrize(
    ("x_m", "turn_deg"), [(500.0, 30.0), (20.0, 0.0), (0.0, 180.0), (1e6, -90.0)]
)
def test_a_frame_that_is_rotated_or_moved_is_found_with_its_transform(parameters, x_m, turn_deg):
    rotation = Rotation.from_euler("z", turn_deg, degrees=True)
    (check,) = checked(parameters, monday=unchanged, tuesday=moved(x_m, rotation))
    found = check.disagreement
    assert found is not None
    assert check.transform is not None
    assert found.others == ("monday",)
    own = passes(parameters)["tuesday"][0].poses[:, :3].copy()
    as_given = moved(x_m, rotation)(passes(parameters)["tuesday"][0].poses)[:, :3]
    rows = [scan for scan, *_ in found.scans]
    off_m = np.linalg.norm(check.transform.apply(as_given) - own, axis=1)[rows]
    assert off_m.max() < 3.0
    assert np.linalg.norm(as_given.mean(axis=0) - check.middle_m) < 50.0
    assert check.transform.about(np.array(check.middle_m)) in str(check)
    with pytest.raises(FramesDisagree, match=r"tuesday .* than those of monday"):
        require_one_frame([check])


def test_axes_of_a_camera_are_found_with_their_tilt(parameters):
    camera = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    (check,) = checked(parameters, monday=unchanged, tuesday=moved(0.0, camera))
    assert check.transform is not None
    assert check.transform.tilt_deg == pytest.approx(90.0, abs=5.0)
    assert ", tilted by" in str(check)


def test_a_drive_in_the_opposite_lane_agrees_or_is_not_matched(parameters):
    (check,) = checked(parameters, monday=unchanged, back=unchanged)
    assert check.disagreement is None
    assert check.met == (parameters.encoding == "harmonic")  # the paper's does not match it


def test_drives_that_never_meet_have_a_note_only(parameters):
    (check,) = checked(parameters, monday=unchanged, elsewhere=moved(1000.0))
    assert check.disagreement is None
    assert not check.met
    assert "could not be checked" in str(check.note)
    assert "align: auto" not in str(check.note)


def test_the_note_on_a_drive_that_is_not_confirmed_says_where_the_graph_joins_it(parameters):
    middle_m = passes(parameters)["monday"][0].poses[30, :3]

    def crossing(poses):
        turned = moved(0.0, Rotation.from_euler("z", 90.0, degrees=True))(poses)
        return np.column_stack([turned[:, :3] + middle_m - turned[30, :3], turned[:, 3:]])

    (check,) = checked(parameters, monday=unchanged, elsewhere=crossing)
    assert check.disagreement is None
    assert not check.met
    assert "comes within 20 m of theirs" in str(check.note)
    assert "align: auto" in str(check.note)


def test_only_the_drive_in_another_frame_is_named(parameters):
    rotation = Rotation.from_euler("z", 30.0, degrees=True)
    elsewhere, tuesday = checked(
        parameters,
        monday=unchanged,
        elsewhere=moved(1000.0),
        tuesday=moved(500.0, rotation),
    )
    assert elsewhere.disagreement is None
    assert tuesday.disagreement is not None
    assert tuesday.disagreement.others == ("monday",)


def test_drives_without_poses_are_not_checked(parameters):
    progress = Stages()
    assert not checked(parameters, progress, monday=unchanged, tuesday=unknown)
    assert not checked(parameters, progress, monday=unknown, tuesday=unchanged)
    assert not progress.stages


def test_checking_reports_its_progress(parameters):
    progress = Stages()
    checked(parameters, progress, monday=unchanged, tuesday=unchanged)
    ((stage, total),) = progress.stages
    assert stage == "checking frames"
    assert progress.units == total


@pytest.mark.parametrize("level", [True, False])
def test_a_consensus_is_found_among_mostly_wrong_matches(level):
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 300.0, (100, 3)) * [1.0, 1.0, 0.02]
    rotation = Rotation.from_euler("z", 40.0, degrees=True)
    matched = rotation.apply(points) + np.array([500.0, -20.0, 1.0])
    matched += rng.normal(scale=0.5, size=(100, 3))
    wrong = np.arange(100) >= 40
    matched[wrong] = rng.uniform(0.0, 300.0, (60, 3))
    turn_deg = np.where(wrong, rng.uniform(-180.0, 180.0, 100), 40.0) if level else None
    found = find_consensus(points, matched, turn_deg, 5.0, level=level)
    assert found is not None
    assert found.agrees[~wrong].all()
    assert found.agrees[wrong].sum() <= 3
    assert found.transform.yaw_deg == pytest.approx(40.0, abs=1.0)


def test_two_matches_are_no_consensus():
    places = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    assert find_consensus(places, places, None, 5.0) is None
