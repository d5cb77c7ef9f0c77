"""The fit of a frame to matches whose transform is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.frames.consensus import Consensus, find_consensus
from core.frames.fit import fit_frame
from core.frames.matches import Matches
from core.scans.rigid import RigidTransform, about_vertical

LENGTH_M, SCANS = 600.0, 60


def road(rotation, *, verticals=None, seed=3):
    """Return matches of a straight road whose drive is in a frame of another rotation."""
    rng = np.random.default_rng(seed)
    along_m = np.linspace(0.0, LENGTH_M, SCANS)
    aside_m = rng.normal(0.0, 0.3, SCANS)
    points_m = np.column_stack([along_m, aside_m, rng.normal(0.0, 0.05, SCANS)])
    matched_m = points_m @ rotation.T + [100.0, 200.0, 5.0]
    matched_m += rng.normal(0.0, 0.5, (SCANS, 3)) * [1.0, 1.0, 0.1]
    swaying = Rotation.from_rotvec(rng.normal(0.0, 0.02, (SCANS, 3)))
    up = swaying.apply([0.0, 0.0, 1.0]) if verticals is None else verticals(rng)
    headings = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0])) + rng.normal(0, 2, SCANS)
    rows = np.arange(SCANS)
    return Matches(
        SCANS, rows, rows, points_m, matched_m, np.tile([0.0, 0.0, 1.0], (SCANS, 1)),
        up @ rotation.T, headings,
    )  # fmt: skip


def off_deg(transform, rotation):
    return np.degrees(Rotation.from_matrix(transform.rotation @ rotation.T).magnitude())


def fitted(matches, *, level):
    found = find_consensus(matches.points_m, matches.matched_m, None, 5.0, level=level)
    assert found is not None
    return fit_frame(found, matches)


@pytest.mark.parametrize("seed", range(6))
def test_the_roll_of_a_straight_road_comes_from_the_verticals_of_its_poses(seed):
    rotation = Rotation.from_euler("ZY", [40.0, 2.0], degrees=True).as_matrix()
    fit = fitted(road(rotation, seed=seed), level=False)
    assert off_deg(fit.transform, rotation) < 0.7
    assert off_deg(fit.transform, rotation) < 4.0 * fit.error_deg
    assert fit.error_deg < 0.5


def test_a_roll_that_neither_positions_nor_verticals_show_is_stated_as_unknown():
    def anywhere(rng):
        up = rng.normal(size=(SCANS, 3))
        return up / np.linalg.norm(up, axis=1, keepdims=True)

    rotation = Rotation.from_euler("ZY", [40.0, 2.0], degrees=True).as_matrix()
    assert fitted(road(rotation, verticals=anywhere), level=False).error_deg > 3.0


def test_rounding_does_not_make_a_level_fit_a_tilted_one():
    rotations = about_vertical(np.radians(np.linspace(-180.0, 180.0, 2001)))
    (rounded,) = rotations[rotations[:, 2, 2].argmin()][None]
    assert rounded[2, 2] < 1.0
    matches = road(rounded)
    transform = RigidTransform(rounded, np.array([100.0, 200.0, 5.0]))
    fit = fit_frame(Consensus(transform, np.ones(SCANS, bool), level=True), matches)
    assert fit.transform.tilt_deg < 1e-4
    found = find_consensus(matches.points_m, matches.matched_m, matches.turn_deg, 5.0)
    assert found is not None
    assert found.level
