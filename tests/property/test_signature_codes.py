"""A large map is searched by its codes, and answers as if they were decoded."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.encodings.distance import Distance
from core.encodings.harmonic import codes, model
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonics import encode
from core.errors import InvalidMap
from core.projection.visibility import View

COLUMNS = 120
U = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 6)))[0].astype(np.float32)
VIEWS = [View(), View(tuple(range(10, 30))), View((3, 4), rings=5)]


def images(seed, scans):
    rng = np.random.default_rng(seed)
    return np.maximum(rng.normal(size=(scans, 3, 8, COLUMNS)).cumsum(axis=-1), 0.0)


def a_map(seed, scans=40, measure=Distance.NORMALISED, hidden=None, views="any"):
    signatures = encode(images(seed, scans), U, 12).astype(np.complex64)
    if views == "any":
        hidden = np.zeros((scans, 3), np.int64) if hidden is None else hidden
    offsets_m, start = np.array([-2.0, 0.0, 2.0]), np.array([0, scans])
    stored = SignatureCodes.of(signatures)
    return HarmonicModel(U, stored, offsets_m, start, COLUMNS, measure, (4, 5), hidden)


def large(small, monkeypatch):
    """Return the same map, decoded for each query in blocks of a few renderings."""
    monkeypatch.setattr(model, "_MOST_DECODED", 0)
    monkeypatch.setattr(codes, "BLOCK_RENDERINGS", 50)
    monkeypatch.setattr(model, "_DECODED_SCANS", 7)
    again = replace(small)
    assert again.is_large
    assert len(again.blocks) == 3
    return again


def same(one, other, largest=1.0):
    np.testing.assert_array_equal(one.rows, other.rows)
    np.testing.assert_allclose(one.distances, other.distances, atol=1e-6 * largest)
    np.testing.assert_allclose(one.relative_yaw_deg, other.relative_yaw_deg, atol=1e-2)
    np.testing.assert_array_equal(one.lateral_m, other.lateral_m)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("blind", [False, True])
def test_a_large_map_of_any_views_answers_as_a_small_one(monkeypatch, view, blind):
    hidden = np.random.default_rng(3).integers(0, 2**60, (40, 3)) if blind else None
    small = a_map(1, hidden=hidden)
    cells = images(1, 40)[17, 2] + np.random.default_rng(4).normal(size=(8, COLUMNS))
    values = encode(cells[: view.rings], U[: view.rings, :4], 5)
    expected = small.search_values(values, view)
    few = np.arange(40) % 3 == 2
    wanted = expected.nearest(9), expected.nearest(4, few)
    distances, estimates = expected.distances(), expected._estimates
    viewpoints = expected.viewpoints(np.array([3, 17]), np.array([10.0, 20.0]))
    found = large(small, monkeypatch).search_values(values, view)
    same(found.nearest(9), wanted[0])
    same(found.nearest(4, few), wanted[1])
    np.testing.assert_allclose(found.distances(), distances, atol=1e-6)
    np.testing.assert_allclose(found._estimates, estimates, atol=1e-5)
    again = found.viewpoints(np.array([3, 17]), np.array([10.0, 20.0]))
    assert again is not None
    assert viewpoints is not None
    np.testing.assert_allclose(again.renderings, viewpoints.renderings, atol=1e-4)


@pytest.mark.parametrize("measure", Distance)
def test_a_large_map_of_full_views_answers_as_a_small_one(monkeypatch, measure):
    small = a_map(2, measure=measure, views="full")
    values = encode(images(2, 40)[17, 2], U, 12)
    expected = small.search_values(values).nearest(9)
    found = large(small, monkeypatch).search_values(values).nearest(9)
    same(found, expected, small.norms.max() ** 2 if measure == Distance.PLAIN else 1.0)


def test_a_large_map_keeps_nothing_decoded(monkeypatch):
    tensor_map = large(a_map(1), monkeypatch)
    for view in VIEWS:
        values = encode(images(1, 1)[0, 1][: view.rings], U[: view.rings, :4], 5)
        tensor_map.search_values(values, view).nearest(3)
        limited = tensor_map.seen_within(view.rings, 4)
        assert np.shares_memory(limited.stored.codes, tensor_map.stored.codes)
        for kept in (tensor_map, limited, tensor_map.seen, limited.seen):
            assert not {"units", "_numbers", "_of_each"} & vars(kept).keys()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), power=st.integers(-30, 8))
def test_a_number_is_rounded_to_127_steps_of_the_largest_of_its_rendering(seed, power):
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(2, 5, 3, 4, 6)) * 10.0**power * rng.uniform(0, 9, size=(5, 3, 1, 1))
    signatures = (parts[0] + 1j * parts[1]).astype(np.complex64)
    signatures.imag[..., 0] = 0.0
    signatures[2, 1] = 0.0
    stored = SignatureCodes.of(signatures)
    again = stored.at(np.arange(5))
    largest = np.maximum(np.abs(signatures.real), np.abs(signatures.imag)).max(axis=(2, 3))
    step = (largest / 127)[..., None, None]
    for part in (again - signatures).real, (again - signatures).imag:
        assert (np.abs(part) <= 0.5001 * step).all()
    assert stored.shape == signatures.shape
    assert stored.codes.nbytes == 5 * 3 * 4 * (2 * 6 - 1)
    rounded_again = SignatureCodes.of(again)
    np.testing.assert_array_equal(rounded_again.codes, stored.codes)


def test_scans_that_are_selected_and_joined_keep_their_codes():
    one, other = a_map(1), a_map(2)
    rows = np.array([4, 5, 9])
    selected = one.select(rows, np.array([0]), np.array([0, 3]))
    joined = selected.joined([other], np.array([0, 3, 43]))
    assert isinstance(joined.stored, SignatureCodes)
    np.testing.assert_array_equal(joined.signatures[:3], one.signatures[rows])
    np.testing.assert_array_equal(joined.signatures[3:], other.signatures)


def test_numbers_of_an_older_map_become_codes_where_they_are_joined_with_codes():
    one, other = a_map(1), a_map(2)
    older = replace(other, stored=other.signatures)
    start = np.array([0, 40, 80])
    joined = older.joined([one], start)
    assert isinstance(joined.stored, SignatureCodes)
    np.testing.assert_array_equal(joined.stored.codes[..., :40], other.as_codes().codes)
    assert isinstance(older.joined([older], start).stored, np.ndarray)


@pytest.mark.parametrize(
    ("of_codes", "of_scales", "message"),
    [
        (np.zeros((4, 2, 3, 5), np.int8), (5, 3), "signature_codes"),
        (np.zeros((5, 2, 3), np.int8), (5, 3), "signature_codes"),
        (np.zeros((5, 2, 3, 5), np.uint8), (5, 3), "signature_codes is uint8"),
        (np.zeros((5, 2, 3, 5), np.int8), (3, 5), r"rendering_scales has shape \(3, 5\)"),
    ],
)
def test_codes_and_scales_that_do_not_fit_are_rejected(of_codes, of_scales, message):
    with pytest.raises(InvalidMap, match=message):
        SignatureCodes(of_codes, np.ones(of_scales, np.float32))
