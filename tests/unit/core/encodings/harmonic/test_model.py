"""Models of the harmonic encoding."""

from tests.support.samples import sample_harmonic_map


def test_a_model_is_shown_in_a_line_without_arrays() -> None:
    model = sample_harmonic_map()[0].model
    scans, segments, ranks, grid_shape = len(model), model.segments, model.ranks, model.grid_shape
    assert (
        repr(model)
        == f"HarmonicModel({scans=}, {segments=}, renderings=3, {ranks=}, {grid_shape=})"
    )
