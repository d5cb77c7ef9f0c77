"""Walks from few places lead where the whole map does."""

from dataclasses import replace

import numpy as np
import pytest

from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.walks import MAX_STRIDES, places_of
from tests.support.samples import sample_map, without_poses


def graph_of(spacing_m, *unposed, **options):
    """Return the graph of a map with a scan each so many metres, some without a pose."""
    whole = sample_map(step_m=spacing_m, **options)[0]
    # Each segment begins half a metre beside the one before: steps there are longer than others.
    poses = whole.trajectory.poses.copy()
    poses[:, 1] += 0.5 * (whole.model.segment_of_scan % 2)
    whole = replace(whole, trajectory=replace(whole.trajectory, poses=poses))
    return TravelGraph.of_map(without_poses(whole, *unposed))


@pytest.mark.parametrize("travelled_m", [None, 2.3, -2.3])
@pytest.mark.parametrize("spacing_m", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("unposed", [(), range(20, 32), range(90)])
def test_few_places_advance_as_all_do(spacing_m, travelled_m, unposed):
    graph = graph_of(spacing_m, *unposed, count=90, segment_length=30, drives=2)
    motion = Motion()
    rng = np.random.default_rng(0)
    few = places_of(np.sort(rng.choice(len(graph), 7, replace=False)))
    at = np.zeros((graph.places, len(motion.pace)))
    at[few] = rng.random((len(few), len(motion.pace)))
    every = np.arange(graph.places)
    _, of_all = motion.advance(every, at, graph, 1.0, travelled_m)
    reached, of_few = motion.advance(few, at[few], graph, 1.0, travelled_m)
    spread = np.zeros_like(of_all)
    spread[reached] = of_few
    np.testing.assert_allclose(spread, of_all, atol=1e-7)
    assert of_few.sum() == pytest.approx(at.sum())


@pytest.mark.parametrize("spacing_m", [0.1, 0.3, 1.0])
def test_the_length_of_a_walk_is_that_of_its_strides(spacing_m):
    graph = graph_of(spacing_m, count=400, segment_length=100)
    stride_m = graph.walks.length_m[1, 2 * 150]
    assert stride_m == pytest.approx(max(0.5, spacing_m), abs=0.06)
    at = np.zeros((1, 1))
    for count in range(MAX_STRIDES + 1):
        at[:], weights = 1.0, np.zeros((MAX_STRIDES + 1, 1, 1))
        weights[count] = 1.0
        reached, moved = graph.walks.moved(np.array([2 * 150]), at, weights)
        mean_m = moved[:, 0] @ graph.along_m[reached // 2] - graph.along_m[150]
        assert graph.walks.length_m[count, 2 * 150] == pytest.approx(mean_m)
