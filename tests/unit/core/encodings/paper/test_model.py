"""Models of the paper's encoding."""

import numpy as np
import pytest

from core.encodings.paper.model import PaperModel
from core.encodings.signature import Signature
from tests.support.samples import sample_map


def test_a_model_is_shown_in_a_line_without_arrays() -> None:
    model = sample_map(count=6, segment_length=3)[0].model
    ranks, grid_shape = model.ranks, model.grid_shape
    assert repr(model) == f"PaperModel(scans=6, segments=2, {ranks=}, {grid_shape=})"


@pytest.mark.parametrize("sent", [(0, 1), (1, 0)])
def test_of_equally_near_scans_the_earlier_one_is_first_in_whatever_order_segments_are_sent(
    sent: tuple[int, int],
) -> None:
    model = sample_map(count=10, segment_length=10)[0].model
    twice = model.joined([model], np.array([0, 10, 20]))
    values = model.signatures[4] + np.float32(0.1)
    found = twice.search([Signature(values, segment, "0f" * 32) for segment in sent]).nearest(2)
    assert found.distances[0] == found.distances[1]
    assert found.rows.tolist() == [4, 14]


@pytest.mark.parametrize("segments", [[0], [1], [1, 0], [0, 1]])
def test_distances_are_those_of_each_segments_own_scans(segments: list[int]) -> None:
    model = sample_map(count=7, segment_length=4)[0].model
    assert isinstance(model, PaperModel)
    values = np.random.default_rng(3).normal(size=(len(segments), *model.ranks))
    rows, distances = model.distances(values, np.array(segments))
    expected = [
        (row, np.linalg.norm(model.signatures[row] - of_segment))
        for of_segment, segment in zip(values, segments, strict=True)
        for row in range(*model.segment_start[segment : segment + 2])
    ]
    assert rows.tolist() == [row for row, _ in expected]
    np.testing.assert_allclose(distances, [distance for _, distance in expected], rtol=1e-12)
