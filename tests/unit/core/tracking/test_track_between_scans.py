"""A vehicle in a map whose scans are far apart: its position is that of its estimated pose."""

import numpy as np
import pytest

from core.encodings.distance import Distance
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.parameters import MapParameters
from core.projection.imager import Image
from core.projection.images import MemoryImages
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.tracking.stationary import StationaryDetector
from core.tracking.track import Observation, Track, Tracker
from tests.support.samples import random_images, straight_poses, trajectory

GRID = RingGrid(ring_m=10.0, rings=6, azimuth_step_deg=20.0)
SCANS, SPACING_M = 40, 4.0


@pytest.fixture(scope="module")
def tracker():
    parameters = MapParameters(
        "harmonic", (3, 4), Reducer.MEAN, "hdl-64e", GRID, 1.73, Distance.NORMALISED, (0.0,)
    )
    images = MemoryImages(random_images(SCANS, GRID.shape, seed=3)[:, None], GRID)
    driven = trajectory(straight_poses(SCANS, SPACING_M))
    return Tracker(Localizer(fit_map(images, driven, np.arange(0, SCANS + 1, 10), parameters)))


def position_after_a_way(tracker, share, *, stands_for=1):
    """Return a vehicle's position, in scans from the one before it, so far on the way between two.

    It passes one scan after another, and stays there for some observations.
    """
    at_scans, track = random_images(SCANS, GRID.shape, seed=3), Track(tracker)
    for row in [*range(20), *[20] * stands_for]:
        seen = (1.0 - share) * at_scans[row] + share * at_scans[row + 1]
        image = Image(seen.astype(np.float32), GRID)
        step = track.observe(Observation(tracker.localizer.basis.encode(image)))
    assert step.localized
    assert step.stationary == (stands_for > 1)
    return step.position - 20.0


@pytest.mark.parametrize("share", [0.25, 0.4, 0.6, 0.75])
def test_between_scans_its_position_is_within_a_tenth_of_the_way(tracker, share):
    assert position_after_a_way(tracker, share) == pytest.approx(share, abs=0.1)


def test_where_it_stands_it_keeps_its_position(tracker):
    for share in (0.25, 0.75):
        assert position_after_a_way(tracker, share, stands_for=12) == pytest.approx(share, abs=0.1)


def test_where_it_is_taken_to_stand_and_passes_scans_its_position_is_that_of_its_pose_too(
    tracker, monkeypatch
):
    monkeypatch.setattr(StationaryDetector, "update", lambda *_: True)
    assert position_after_a_way(tracker, 0.75, stands_for=4) == pytest.approx(0.75, abs=0.1)
