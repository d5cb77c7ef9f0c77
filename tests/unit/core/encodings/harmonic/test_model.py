"""Models of the harmonic encoding."""

import gc
import weakref

import numpy as np
import pytest

from core.encodings.distance import Distance
from core.encodings.harmonic import renderings
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonics import encode
from core.projection.visibility import View
from tests.support.samples import random_images, sample_harmonic_map

U = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 6)))[0].astype(np.float32)


def test_a_model_is_shown_in_a_line_without_arrays() -> None:
    model = sample_harmonic_map()[0].model
    scans, segments, ranks, grid_shape = len(model), model.segments, model.ranks, model.grid_shape
    assert (
        repr(model)
        == f"HarmonicModel({scans=}, {segments=}, renderings=3, {ranks=}, {grid_shape=})"
    )


def a_model(*, any_views: bool) -> HarmonicModel:
    """Return a model of 40 scans, one of whose renderings does not see everything."""
    images = random_images(120, (8, 120)).reshape(40, 3, 8, 120)
    stored = SignatureCodes.of(encode(images, U, 12).astype(np.complex64))
    hidden = np.zeros((40, 3), np.int64)
    hidden[7, 1] = 0b111
    return HarmonicModel(
        U, stored, np.array([-2.0, 0.0, 2.0]), np.array([0, 40]), 120, Distance.NORMALISED,
        (4, 5) if any_views else (6, 12), hidden if any_views else None,
    )  # fmt: skip


@pytest.mark.parametrize("most_decoded", [0, 20_000], ids=["large", "small"])
@pytest.mark.parametrize(
    ("ranks", "view"),
    [
        ((6, 12), None),
        ((6, 12), View()),
        ((4, 5), View()),
        ((4, 5), View((3, 4))),
        ((6, 5), View(tuple(range(30)))),
        ((4, 5), View((3, 4), rings=5)),
    ],
    ids=["full views", "all numbers", "whole", "partial", "narrow", "short"],
)
def test_a_model_that_nobody_uses_leaves_the_memory_at_once(
    ranks: tuple[int, int], view: View | None, most_decoded: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderings, "_MOST_DECODED", most_decoded)
    model = a_model(any_views=view is not None)
    values = model.recorded[5, : ranks[0], : ranks[1]]
    gc.disable()  # a service searches for objects that refer to themselves very seldom
    try:
        search = model.search_values(values, view or View())
        search.nearest(30)
        search.distances_for_belief()
        search.least_distances()
        used = [model, model.stored, model.renderings, search._model, search._model.renderings]
        references = [weakref.ref(one) for one in used]
        del model, search, used
        assert [reference() for reference in references] == [None] * 5
    finally:
        gc.enable()
