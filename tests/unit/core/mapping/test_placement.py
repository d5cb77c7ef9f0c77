"""Placements in words."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.mapping.placement import Placement
from core.scans.rigid import RigidTransform


def as_read(text):
    """Return the transform that a note describes, of `(n, 3)` points."""
    [(turn_deg, about, by)] = re.findall(
        r"turned by (\S+) deg about \((.*?)\) and then moved by \((.*?)\) m", text
    )
    middle_m, shift_m = (np.array(part.split(","), np.float64) for part in (about, by))
    turn = Rotation.from_euler("z", float(turn_deg), degrees=True)
    return lambda points_m: turn.apply(points_m - middle_m) + middle_m + shift_m


@pytest.mark.parametrize("origin_m", [(0.0, 0.0, 0.0), (458_000.0, 5_428_000.0, 115.0)])
def test_the_transform_in_a_note_can_be_applied_however_far_the_origin_is(origin_m):
    points_m = np.array(origin_m) + np.random.default_rng(1).uniform(-200.0, 200.0, (9, 3))
    rotation = Rotation.from_euler("z", 0.4567, degrees=True).as_matrix()
    middle_m, shift_m = points_m.mean(axis=0), np.array([3.0, -4.0, 0.5])
    transform = RigidTransform(rotation, middle_m + shift_m - rotation @ middle_m)
    of = Placement.of(transform)
    placement = Placement(
        of.rotation, of.translation_m, ("monday",), 9, centre_m=transform.apply(middle_m[None])[0]
    )
    off_m = as_read(str(placement))(points_m) - transform.apply(points_m)
    assert np.abs(off_m).max() < 0.05


def test_the_words_for_a_transform_without_others_are_how_far_it_moves():
    placement = Placement.of(RigidTransform(np.eye(3), np.array([1032.26, 0.0, 0.0])))
    assert str(placement) == (
        "turned by 0.000 deg about (0.0, 0.0, 0.0) and then moved by (1032.26, 0.00, 0.00) m"
    )
