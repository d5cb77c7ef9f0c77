"""The note on a scan that is not localized and does not have z up."""

import numpy as np
import pytest

from app.localization.axis_notes import axis_notes
from core.scans.mounting import Mounting
from core.scans.scan import Scan
from tests.support.recording import recording

HEIGHT_M = 1.73
SCAN = recording().scans[7]
CAMERA = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], np.float64)
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])


def in_axes(rows, scan=SCAN):
    return Scan.from_returns(scan.points_m @ rows.T)


def test_a_scan_with_z_up_has_no_note():
    assert axis_notes(SCAN, HEIGHT_M, mounted=False) == []
    assert axis_notes(SCAN, HEIGHT_M, mounted=True) == []


@pytest.mark.parametrize(
    ("rows", "axis", "become", "angle"),
    [
        (CAMERA, "-y", "x, y, z become z, -x, -y", "roll -90 (of a camera's axes and yaw -90)"),
        (UPSIDE_DOWN, "-z", "x, y, z become x, -y, -z", "roll 180"),
    ],
)
def test_it_says_how_to_turn_the_scan(rows, axis, become, angle):
    [note] = axis_notes(in_axes(rows), HEIGHT_M, mounted=False)
    assert f"not to be below the sensor: {axis} of the scan points up; wanted are" in note
    assert become in note
    assert note.endswith(f"give its `mounting`, with {angle}")


def test_what_it_says_turns_the_scan():
    x_m, y_m, z_m = in_axes(CAMERA).points_m.T
    assert np.array_equal(np.stack([z_m, -x_m, -y_m], axis=1), SCAN.points_m)
    x_m, y_m, z_m = in_axes(UPSIDE_DOWN).points_m.T
    assert np.array_equal(np.stack([x_m, -y_m, -z_m], axis=1), SCAN.points_m)


def test_the_mounting_that_it_says_turns_the_scan():
    built_in = Mounting(0.0, 0.0, HEIGHT_M, roll_deg=-90.0, yaw_deg=-90.0)
    mounted = built_in.mount(in_axes(CAMERA), HEIGHT_M)
    np.testing.assert_allclose(mounted.points_m, SCAN.points_m, atol=1e-4)


def test_the_ground_is_looked_for_at_the_height_of_each_map():
    heights_m = 3.5, 0.6
    low = SCAN.points_m + np.array([0.0, 0.0, HEIGHT_M - 0.5], np.float32)
    assert axis_notes(in_axes(UPSIDE_DOWN, Scan(low)), heights_m[0], mounted=False) == []
    [note] = axis_notes(in_axes(UPSIDE_DOWN, Scan(low)), *heights_m, mounted=False)
    assert "-z of the scan points up" in note
    assert axis_notes(Scan(low), *heights_m, mounted=False) == []


def test_of_a_mounted_scan_it_is_the_mounting_that_may_be_wrong():
    hanging = Mounting(0.0, 0.0, HEIGHT_M, roll_deg=180.0)
    [note] = axis_notes(hanging.mount(SCAN, HEIGHT_M), HEIGHT_M, mounted=True)
    assert "-z of the scan points up as it is mounted" in note
    assert "correct `mounting`, or leave it out" in note


@pytest.mark.parametrize("returns", [1, 19, 100])
def test_a_scan_of_few_returns_has_no_note(returns):
    assert axis_notes(Scan(in_axes(CAMERA).points_m[:returns]), HEIGHT_M, mounted=False) == []
