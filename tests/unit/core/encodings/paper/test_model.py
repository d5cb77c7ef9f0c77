"""Models of the paper's encoding."""

from tests.support.samples import sample_map


def test_a_model_is_shown_in_a_line_without_arrays() -> None:
    model = sample_map(count=6, segment_length=3)[0].model
    ranks, grid_shape = model.ranks, model.grid_shape
    assert repr(model) == f"PaperModel(scans=6, segments=2, {ranks=}, {grid_shape=})"
