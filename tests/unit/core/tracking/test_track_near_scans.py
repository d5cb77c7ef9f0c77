"""A vehicle in a map whose scans are near each other, as of a slow robot."""

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
from core.tracking.track import Observation, Track, Tracker
from tests.support.samples import random_images, straight_poses, trajectory, without_poses

GRID = RingGrid(ring_m=10.0, rings=6, azimuth_step_deg=20.0)
SCANS, SPACING_M = 800, 0.1


def street(seed, noise):
    """Return images along a street of 80 m that changes each metre, with a seed for their noise."""
    at_metres = random_images(81, GRID.shape, seed=3)
    metre, share = np.divmod(SPACING_M * np.arange(SCANS), 1.0)
    metre, share = metre.astype(int), share[:, None, None]
    images = (1.0 - share) * at_metres[metre] + share * at_metres[metre + 1]
    return (images + noise * random_images(SCANS, GRID.shape, seed=seed)).astype(np.float32)


@pytest.fixture(scope="module")
def tracker():
    parameters = MapParameters(
        "harmonic", (3, 4), Reducer.MEAN, "hdl-64e", GRID, 1.73, Distance.NORMALISED, (0.0,)
    )
    driven = trajectory(straight_poses(SCANS, SPACING_M))
    images = MemoryImages(street(seed=1, noise=0.1)[:, None], GRID)
    return Tracker(Localizer(fit_map(images, driven, np.arange(0, SCANS + 1, 200), parameters)))


@pytest.mark.parametrize("each_m", [0.5, 2.0, 5.0, 8.0])
@pytest.mark.parametrize("knows_metres", [False, True])
def test_it_is_followed_however_many_scans_it_passes_from_one_observation_to_the_next(
    tracker, each_m, knows_metres
):
    require_followed(tracker, each_m, each_m if knows_metres else None)


@pytest.mark.parametrize("each_m", [0.5, 2.0, 5.0])
def test_it_is_followed_through_a_stretch_without_poses(tracker, each_m):
    unposed = without_poses(tracker.map, *range(300, 500))
    require_followed(Tracker(Localizer(unposed)), each_m, each_m)


def require_followed(tracker, each_m, travelled_m):
    """Require places within a quarter of a metre from the fourth observation on at the latest."""
    images, track = street(seed=2, noise=0.1), Track(tracker)
    basis = tracker.localizer.basis
    passed, off_m = range(3, SCANS, round(each_m / SPACING_M)), []
    for row in passed:
        step = track.observe(
            Observation(basis.encode(Image(images[row], GRID)), travelled_m=travelled_m)
        )
        if step.localized:
            off_m.append(abs(step.position - row) * SPACING_M)
    assert len(off_m) >= len(passed) - 4
    assert max(off_m) < 0.25
