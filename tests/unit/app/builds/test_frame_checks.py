"""Drives whose poses were confirmed to be in one frame are not matched again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.builds.drive_build import build_mapped
from app.builds.frame_checks import of_same_poses, pose_digests, require_frames
from app.builds.parameters import Align, BuildParameters
from core.errors import FramesDisagree
from core.parameters import MapParameters
from core.progress import NO_PROGRESS
from core.projection.imager import Views
from storage.files.image_file import ImageFile, write_image_file
from tests.support.passes import SCANS, map_of, moved, passes, unchanged, unknown

pytestmark = pytest.mark.slow

# Full views are built and compared faster, and nothing here depends on views.
PARAMETERS = MapParameters.for_sensor(encoding="harmonic", views=Views.FULL)
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
    matched, tensor_map = Matched(), map_of(PARAMETERS, **places)
    found = require_frames(tensor_map, (), confirmed, matched)
    return matched.scans, {} if found.unsure else pose_digests(tensor_map.trajectory)


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
    with pytest.raises(
        FramesDisagree, match=r"drive tuesday are in another .* than those of monday"
    ):
        checked(confirmed, **places)


def test_if_one_has_other_poses_none_counts_as_confirmed(two):
    _, confirmed = two
    trajectory = map_of(PARAMETERS, monday=unchanged, tuesday=unchanged).trajectory
    assert of_same_poses(trajectory, confirmed) == {"monday", "tuesday"}
    poses = trajectory.poses.copy()
    poses[-1, 0] += 1e-3
    assert of_same_poses(replace(trajectory, poses=poses), confirmed) == set()


def test_one_pose_less_is_another_digest_and_without_any_there_is_none(two):
    _, confirmed = two
    trajectory = map_of(PARAMETERS, monday=unchanged, tuesday=unchanged).trajectory
    poses = trajectory.poses.copy()
    poses[-1] = np.nan
    found = pose_digests(replace(trajectory, poses=poses))
    assert found["monday"] == confirmed["monday"]
    assert found["tuesday"] != confirmed["tuesday"]
    poses[SCANS:] = np.nan
    assert list(pose_digests(replace(trajectory, poses=poses))) == ["monday"]


class Passed:
    """A pass with other poses."""

    def __init__(self, name, change):
        self._drive = passes(PARAMETERS)[name][0]
        self.name, self.timestamp_s = name, self._drive.timestamp_s
        self.poses = change(self._drive.poses)

    def __len__(self):
        return len(self._drive)

    def scan(self, index):
        return self._drive.scan(index)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build passes, on an earlier build if there is one; return it and how many were matched."""
    folder = tmp_path_factory.mktemp("images")
    parameters = BuildParameters(encoding="harmonic", views=Views.FULL, segment_length=30)
    imager = parameters.map_parameters().imager

    def images_of(drive):
        path = folder / f"{drive.name}.h5"
        if not path.exists():
            write_image_file(path, drive, imager, NO_PROGRESS)
        return ImageFile(path, imager)

    def build(frameless=(), before=None, align=Align.CHECK, **places):
        matched = Aligned()
        found = build_mapped(
            [Passed(name, change) for name, change in places.items()],
            images_of,
            parameters.model_copy(update={"align": align}),
            matched,
            None,
            placements=before and before.tensor_map.placements,
            frameless=frameless,
            confirmed=before and before.confirmed_frames,
        )
        return found, matched.scans

    return build


class Aligned(Matched):
    """The number of scans that are matched to align drives or to check them."""

    def start(self, stage, total):
        if "drives" in stage or "frames" in stage:
            super().start(stage, total)


def test_drives_that_were_aligned_stay_where_they_are(built):
    places = {"monday": unchanged, "tuesday": OTHER_FRAME}
    first, matched = built(["tuesday"], **places)
    assert matched > 20
    assert set(first.confirmed_frames) == {"monday", "tuesday"}
    again, matched = built(["tuesday"], first, **places)
    assert matched == 0
    assert again.confirmed_frames == first.confirmed_frames
    assert again.tensor_map.placements == first.tensor_map.placements
    # Other poses of it are aligned anew.
    other, matched = built(["tuesday"], first, monday=unchanged, tuesday=moved(80.0))
    assert matched > 20
    assert other.tensor_map.placements["tuesday"] != first.tensor_map.placements["tuesday"]


@pytest.mark.parametrize("align", [Align.CHECK, Align.AUTO])
def test_drives_without_a_frame_are_brought_into_that_of_the_first_drive_that_has_one(built, align):
    first, _ = built(["monday", "tuesday"], monday=OTHER_FRAME, tuesday=OTHER_FRAME, align=align)
    assert set(first.confirmed_frames) == {"monday", "tuesday"}
    places = {"monday": OTHER_FRAME, "tuesday": OTHER_FRAME, "back": unchanged}
    found, _ = built(["monday", "tuesday"], first, **places, align=align)
    assert set(found.tensor_map.placements) == {"monday", "tuesday"}
    true_m = passes(PARAMETERS)["monday"][0].poses[:, :3]
    assert np.abs(found.tensor_map.trajectory.poses[:SCANS, :3] - true_m).max() < 3.0


@pytest.mark.parametrize("frameless", [[], ["elsewhere"]])
def test_while_one_drive_meets_none_all_are_matched_each_time_and_the_note_stays(built, frameless):
    places = {"monday": unchanged, "tuesday": unchanged, "elsewhere": moved(1000.0)}
    first, matched = built(frameless, **places)
    assert first.confirmed_frames == {}
    again, as_many = built(frameless, first, **places)
    assert as_many == matched
    assert "elsewhere" in again.of_frames[-1]
    assert again.of_frames[-1] == first.of_frames[-1]


def test_a_drive_without_poses_does_not_hold_others_in_a_frame_of_their_own(built):
    bare = {"elsewhere": unknown, "monday": OTHER_FRAME, "tuesday": OTHER_FRAME}
    first, _ = built(["monday", "tuesday"], **bare)
    assert set(first.confirmed_frames) == {"monday", "tuesday"}
    found, _ = built(["monday", "tuesday"], first, **bare, back=unchanged)
    true_m = passes(PARAMETERS)["monday"][0].poses[:, :3]
    placed_m = found.tensor_map.trajectory.poses[SCANS : 2 * SCANS, :3]
    assert np.abs(placed_m - true_m).max() < 3.0


def test_a_build_that_checks_nothing_confirms_nothing(built):
    found, matched = built(monday=unchanged, tuesday=OTHER_FRAME, align=Align.OFF)
    assert (found.confirmed_frames, matched) == ({}, 0)
