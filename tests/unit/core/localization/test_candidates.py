"""Candidates within a prior, and what is nearer outside of it."""

from dataclasses import replace

import numpy as np
import pytest

from core.confidence.calibration import Calibration
from core.confidence.decision import Refusal
from core.encodings.search import Neighbours
from core.localization.candidates import Candidates, find_candidates
from core.localization.priors import MapPrior, PositionPrior, Priors
from core.mapping.fit import fit_map
from core.projection.images import MemoryImages
from core.scans.trajectory import Trajectory
from tests.support.samples import (
    SMALL_GRID,
    calibrated_map,
    own_signatures,
    random_images,
    sample_image,
    straight_poses,
)

CALIBRATION = Calibration(0.001, (0.0, -1.5, -10.0), (0.0, -1.5), (-8.0, -3.0))


def found_at(distance, runner_up, outside=None):
    best, away = (
        Neighbours.of_distances(np.array([row]), np.array([far]))
        for row, far in ((0, distance), (50, runner_up))
    )
    return Candidates(best, away, share=1.0, evidence=1.0, outside=outside)


@pytest.mark.parametrize(("runner_up", "reason"), [(0.25, Refusal.OUTSIDE_PRIOR), (0.005, None)])
def test_a_far_better_match_outside_refuses_only_if_it_would_be_accepted(runner_up, reason):
    outside = found_at(0.005, runner_up)
    assert outside.decide(CALIBRATION, None, None).localized == (runner_up == 0.25)
    inside = found_at(0.06, 0.3, outside)
    assert inside.decide(CALIBRATION, None, None).reason == reason


@pytest.mark.parametrize("position_m", [20.0, 58.0])
def test_the_share_that_is_searched_is_that_of_the_prior_and_of_the_segments(position_m):
    tensor_map = calibrated_map()
    priors = Priors(position=PositionPrior(position_m, 0.0, 2.0))
    prior = MapPrior(priors, tensor_map)
    first, _ = own_signatures(tensor_map, 55)  # of the first of two segments
    found = find_candidates(tensor_map, tensor_map.model.search([first]), 1, prior)
    assert found.share == pytest.approx((prior.rows & (np.arange(120) < 60)).mean())


def test_of_runners_up_the_one_counts_that_the_prior_allows_more():
    like = calibrated_map()
    images = np.tile(random_images(20, SMALL_GRID.shape), (3, 1, 1))
    images[5, 1, 1] += np.float32(0.02)
    images[25, 1, 1] += np.float32(0.01)  # farther from the query than the one at 45 m
    trajectory = Trajectory.of_drive("alike", np.arange(60.0), straight_poses(60), np.arange(60))
    source = MemoryImages(images, SMALL_GRID)
    made = fit_map(source, trajectory, np.array([0, 60]), like.parameters)
    tensor_map = replace(made, calibration=like.calibration)
    search = tensor_map.model.search_image(sample_image(tensor_map, images[45]), made.basis())
    prior = MapPrior(Priors(position=PositionPrior(5.0, 0.0, 14.0)), tensor_map)
    found = find_candidates(tensor_map, search, 1, prior)
    assert (found.matches.rows.tolist(), found.away.rows.tolist()) == ([5], [25])
