"""Drives that are brought into one frame."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.encodings.registry import encoding_names
from core.errors import FramesDisagree
from core.frames.alignment import align_drives, aligned_map
from core.mapping.merge import without_drives
from core.mapping.placement import placed
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from tests.support.passes import map_of, moved, passes, unchanged, unknown

pytestmark = pytest.mark.slow

HARMONIC = MapParameters.for_sensor(encoding="harmonic")
TURNED = Rotation.from_euler("z", 30.0, degrees=True)


def aligned(*, movable=None, frameless=(), parameters=HARMONIC, **places):
    """Return the alignment of passes, and the worst error of each drive's position."""
    tensor_map = map_of(parameters, **places)
    found = align_drives(tensor_map, places if movable is None else movable, frameless)
    transforms = {name: of.transform for name, of in found.placements.items()}
    now = placed(tensor_map.trajectory, transforms)
    off_m = {
        name: np.linalg.norm(
            now.poses[now.drive_of_scan == position, :3] - passes(parameters)[name][0].poses[:, :3],
            axis=1,
        ).max()
        for position, name in enumerate(places)
    }
    return found, off_m


@pytest.mark.parametrize("encoding", encoding_names())
def test_a_drive_in_another_frame_is_aligned_and_its_transform_is_known(encoding):
    found, off_m = aligned(
        parameters=MapParameters.for_sensor(encoding=encoding),
        monday=unchanged,
        tuesday=moved(500.0, TURNED),
    )
    (placement,) = found.placements.values()
    assert off_m["tuesday"] < 0.5
    assert placement.transform.yaw_deg == pytest.approx(-30.0, abs=0.5)
    assert placement.others == ("monday",)
    assert placement.error_m < 0.5
    assert turned_deg(found.notes[0]) == pytest.approx(-30.0, abs=0.5)


def test_the_opposite_lane_is_aligned_too():
    found, off_m = aligned(monday=unchanged, back=moved(-40.0, TURNED.inv()))
    assert off_m["back"] < 1.0
    assert found.placements["back"].error_deg < 1.0


def test_a_tilted_vertical_is_aligned():
    camera = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    _, off_m = aligned(monday=unchanged, tuesday=moved(0.0, camera))
    assert off_m["tuesday"] < 1.5


def test_poses_that_agree_are_not_touched():
    found, _ = aligned(monday=unchanged, tuesday=moved(0.5))
    assert (found.placements, found.notes) == ({}, ())


def test_a_drive_that_meets_none_keeps_its_frame_beside_the_others_with_a_note():
    found, _ = aligned(monday=unchanged, elsewhere=moved(5000.0))
    assert not found.placements
    (note,) = found.notes
    assert "elsewhere" in note
    assert "a component of its own" in note


def test_a_drive_that_meets_none_but_would_lie_in_the_same_streets_is_put_beside_them():
    tensor_map = map_of(HARMONIC, monday=unchanged, elsewhere=moved(15.0))
    moved_map, (where, why) = aligned_map(tensor_map)
    assert moved_map.drives_aside == {"elsewhere"}
    assert "beside the drives that it does not meet" in where
    assert "a component of its own" in why
    monday = moved_map.trajectory.positions_m[:, moved_map.trajectory.drive_of_scan == 0]
    other = moved_map.trajectory.positions_m[:, moved_map.trajectory.drive_of_scan == 1]
    assert other[0].min() - monday[0].max() == pytest.approx(1000.0)


def test_a_chain_of_drives_is_aligned_whatever_their_order():
    found, off_m = aligned(
        monday=unchanged,
        elsewhere=moved(5000.0),
        back=moved(9000.0, TURNED),
        tuesday=moved(-700.0, TURNED.inv()),
    )
    assert set(found.placements) == {"back", "tuesday"}
    assert max(off_m["back"], off_m["tuesday"]) < 1.0


@pytest.mark.parametrize("factor", [1.5, 1000.0])
def test_poses_that_no_transform_brings_into_the_frame_fail_with_the_evidence(factor):
    def scaled(poses):
        rows = poses.copy()
        rows[:, :3] *= factor
        return rows

    with pytest.raises(FramesDisagree, match=r"no transform brings .*: scan \d+ matches \d+ of"):
        aligned(monday=unchanged, tuesday=scaled)


def test_poses_by_odometry_are_aligned_to_given_ones_whatever_their_order():
    found, off_m = aligned(
        monday=moved(300.0, TURNED),
        tuesday=unchanged,
        movable=["monday"],
        frameless=["monday"],
    )
    assert set(found.placements) == {"monday"}
    assert max(off_m.values()) < 0.5


def test_poses_by_odometry_that_meet_none_lie_beside_the_others():
    found, _ = aligned(
        monday=unchanged,
        elsewhere=moved(5000.0),
        movable=["elsewhere"],
        frameless=["elsewhere"],
    )
    assert found.placements["elsewhere"].others == ()


def test_a_drive_that_meets_only_one_that_lies_beside_the_others_lies_there_too():
    names = ("elsewhere", "monday", "tuesday")
    tensor_map = map_of(HARMONIC, elsewhere=unchanged, monday=moved(9.0), tuesday=moved(500.0))
    found, _ = aligned_map(tensor_map, frameless=names)
    assert found.placements["tuesday"].others == ("monday",)
    assert found.drives_aside == {"monday", "tuesday"}
    left = without_drives(found, ["monday"])
    assert left.drives_aside == {"tuesday"}
    assert without_drives(left, ["elsewhere"]).drives_aside == set()


def test_a_drive_that_was_placed_before_stays_where_it_is():
    first, _ = aligned_map(map_of(HARMONIC, monday=unchanged, tuesday=moved(500.0, TURNED)))
    again, notes = aligned_map(first)
    assert notes == ()
    assert again.revision == first.revision
    kept = align_drives(first, ["tuesday"], ["tuesday"])
    assert kept.placements == {}


def test_drives_without_poses_are_left_as_they_are():
    found, _ = aligned(monday=unchanged, tuesday=unknown)
    assert (found.placements, found.notes) == ({}, ())


def test_placements_are_part_of_a_map_and_of_its_digest():
    plain = map_of(HARMONIC, monday=unchanged, tuesday=moved(500.0, TURNED))
    tensor_map, _ = aligned_map(plain)
    read = TensorMap.from_parts(tensor_map.arrays(), tensor_map.attributes())
    assert read.placements == tensor_map.placements
    assert read.revision == tensor_map.revision
    assert "placements" not in plain.attributes()
    assert without_drives(tensor_map, ["tuesday"]).placements == {}
    assert set(without_drives(tensor_map, ["monday"]).placements) == {"tuesday"}


def turned_deg(text):
    """Return the rotation that a note on drive tuesday states."""
    assert "tuesday" in text
    [angle] = re.findall(r"turned by (\S+) deg about", text)
    return float(angle)
