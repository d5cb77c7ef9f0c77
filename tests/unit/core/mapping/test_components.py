"""Which drives lie in the frame of their map, and which beside it."""

from dataclasses import replace

import numpy as np
import pytest

from core.mapping.components import drives_aside, placements_without
from core.mapping.merge import merge_maps, without_drives
from core.mapping.placement import Placement
from core.scans.rigid import RigidTransform
from tests.support.samples import sample_map, without_poses

LIES = Placement.of(RigidTransform(np.eye(3), np.array([1000.0, 0.0, 0.0])))


def meets(*others):
    return replace(LIES, others=others, matches=20, spread_m=0.3, error_m=0.1)


@pytest.mark.parametrize(
    ("placements", "aside"),
    [
        ({}, ""),
        ({"b": meets("a")}, ""),
        ({"b": LIES}, "b"),
        ({"b": LIES, "c": meets("b")}, "bc"),
        ({"b": meets("c"), "c": LIES}, "bc"),
        ({"b": LIES, "c": meets("b"), "d": meets("c")}, "bcd"),
        ({"b": LIES, "c": meets("b"), "d": meets("a", "c")}, "bc"),
        ({"b": meets("d"), "c": meets("b"), "d": meets("a")}, ""),
        ({"b": meets("c"), "c": meets("b")}, "bc"),
        ({"b": meets("removed")}, ""),
    ],
)
def test_a_drive_that_was_fitted_only_to_drives_aside_lies_aside_with_them(placements, aside):
    assert drives_aside("abcd", placements) == {*aside}


@pytest.mark.parametrize(
    ("drives", "placements", "aside"),
    [
        ("b", {"b": LIES}, ""),
        ("bc", {"b": LIES, "c": meets("b")}, ""),
        ("cb", {"b": LIES, "c": meets("b")}, ""),
        ("bc", {"b": LIES, "c": LIES}, "c"),
        ("becd", {"b": LIES, "c": LIES, "d": meets("c"), "e": meets("b")}, "cd"),
        ("", {}, ""),
    ],
)
def test_without_a_drive_that_has_the_frame_it_is_that_of_the_first_component(
    drives, placements, aside
):
    assert drives_aside(drives, placements) == {*aside}


def test_a_drive_stays_in_the_frame_when_those_that_it_was_fitted_to_are_removed():
    placements = {"b": LIES, "c": meets("a")}
    left = placements_without("abc", placements, "a")
    assert left == placements
    assert drives_aside("bc", left) == {"b"}


def test_a_drive_stays_aside_when_those_that_it_was_fitted_to_are_removed():
    placements = {"b": LIES, "c": meets("b"), "d": meets("b"), "e": meets("b", "c")}
    left = placements_without("abcde", placements, "b")
    assert left == {"c": LIES, "d": meets("c"), "e": meets("c")}
    assert drives_aside("acde", left) == {"c", "d", "e"}


@pytest.mark.parametrize("removed", ["ab", "ba"])
def test_drives_that_lay_aside_together_are_in_one_frame_when_all_others_are_removed(removed):
    left = {"b": LIES, "c": meets("b"), "d": meets("b"), "e": LIES}
    drives = "abcde"
    for name in removed:  # one after the other
        left = placements_without(drives, left, name)
        drives = drives.replace(name, "")
    assert drives_aside("cde", left) == {"e"}


def placed_map(**placements):
    tensor_map, _ = sample_map(count=8, drives=3)
    return replace(
        tensor_map,
        placements={name.replace("_", "-"): placement for name, placement in placements.items()},
    )


def test_the_drive_that_is_left_of_a_map_is_not_aside():
    whole = placed_map(drive_1=LIES, drive_2=meets("drive-1"))
    assert whole.drives_aside == {"drive-1", "drive-2"}
    assert without_drives(whole, ["drive-0"]).drives_aside == set()
    assert without_drives(whole, ["drive-0", "drive-2"]).drives_aside == set()
    assert without_drives(whole, ["drive-0", "drive-1"]).drives_aside == set()
    assert without_drives(whole, ["drive-1"]).drives_aside == {"drive-2"}


def test_a_drive_aside_lies_aside_again_when_its_map_is_merged_with_the_others():
    whole = placed_map(drive_1=LIES, drive_2=meets("drive-1"))
    parts = [without_drives(whole, ["drive-1", "drive-2"]), without_drives(whole, ["drive-0"])]
    merged = merge_maps(parts)
    assert merged.drives_aside == {"drive-1", "drive-2"}
    assert merged.revision == whole.revision


def test_a_drive_without_poses_has_no_frame_beside_which_others_lie():
    assert without_poses(placed_map(drive_1=LIES), *range(8)).drives_aside == {"drive-1"}
    left = without_drives(placed_map(drive_1=LIES), ["drive-2"])
    assert without_poses(left, *range(8)).drives_aside == set()
