"""A large map is searched by its codes, and answers as if they were decoded."""

import sys
from dataclasses import replace

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.encodings.distance import Distance
from core.encodings.harmonic import codes, in_phase, renderings
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonic.renderings import CodedRenderings
from core.encodings.harmonics import encode
from core.encodings.search import nearest
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
    monkeypatch.setattr(renderings, "_MOST_DECODED", 0)
    monkeypatch.setattr(codes, "BLOCK_RENDERINGS", 50)
    monkeypatch.setattr(renderings, "_DECODED_SCANS", 7)
    again = replace(small)
    assert again.renderings.is_large
    assert len(again.renderings.blocks) == 3
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
    same(found, expected, small.renderings.norms.max() ** 2 if measure == Distance.PLAIN else 1.0)


@pytest.mark.parametrize("least_compiled", [0, 10**9])
def test_waves_in_phase_are_those_of_the_numbers(monkeypatch, least_compiled):
    monkeypatch.setattr(in_phase, "_LEAST_COMPILED", least_compiled)
    rng = np.random.default_rng(5)
    scans = in_phase._COMPILED_BLOCK_SCANS + 1000  # two blocks, the last one short
    some = rng.integers(-127, 128, (11, 6, 3, scans), np.int8)[:, :4]
    factor = rng.uniform(0.0, 2.0, (3, scans)).astype(np.float32)
    query = (rng.normal(size=(4, 5)) + 1j * rng.normal(size=(4, 5))).astype(np.complex64)
    query.imag[:, 0] = 0.0
    numbers = np.concatenate([some[:1], some[1:9:2] + 1j * some[2:9:2]])
    waves = np.einsum("rm,mrdk->mdk", query, numbers.conj())
    of_each = np.abs(waves).sum(axis=0) * factor
    expected = of_each.max(axis=0)
    found = in_phase.best_in_phase(some, query, factor)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    found, which = in_phase.best_rendering_in_phase(some, query, factor)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    np.testing.assert_allclose(of_each[which, np.arange(scans)], expected, rtol=1e-5)
    apart = np.asfortranarray(some)  # as nothing stores them: NumPy reads these
    found = in_phase.best_in_phase(apart, query, factor)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    found = in_phase.best_in_phase(some, query, np.asfortranarray(factor))
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    spans = np.array([[3, 4], [7, 7], [10, 9000], [9001, 9101]])
    rows = np.concatenate([np.arange(*span) for span in spans])
    found, which = in_phase.best_rendering_in_phase(some, query, factor, spans)
    np.testing.assert_allclose(found, expected[rows], rtol=1e-5)
    np.testing.assert_allclose(of_each[which, rows], expected[rows], rtol=1e-5)


@pytest.mark.parametrize("least_compiled", [0, 10**9])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), known=st.booleans(), k=st.integers(1, 9))
def test_a_large_map_finds_what_comparing_every_scan_finds(least_compiled, seed, known, k):
    rng = np.random.default_rng(seed)
    u, scans = U[:, :4], 60
    stored = SignatureCodes.of(encode(images(seed, scans), u, 6).astype(np.complex64))
    start = np.array([0, scans])
    model = HarmonicModel(
        u, stored, np.array([-2.0, 0.0, 2.0]), start, COLUMNS, Distance.NORMALISED, (4, 6)
    )
    cells = images(seed, scans)[7, 1] if known else images(seed + 5000, 1)[0, 0]
    values = encode(np.roll(cells, 30, axis=-1) + rng.normal(size=cells.shape), u, 6)
    among = rng.random(scans) < rng.choice([0.05, 0.7])
    among[rng.integers(scans)] = True  # of none, `ranked` has no nearest
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(in_phase, "_LEAST_COMPILED", least_compiled)
        patch.setattr(in_phase, "_BLOCK_SCANS", 17)
        patch.setattr(renderings, "_MOST_DECODED", 0)
        search = model.search_values(values)
        assert model.renderings.is_large
        for some in None, among:
            rows = np.arange(scans) if some is None else np.flatnonzero(some)
            wanted = search.ranked(rows, *search.exact(rows), k)
            found = search.nearest(k, some)
            for one, other in zip(vars(found).values(), vars(wanted).values(), strict=True):
                np.testing.assert_array_equal(one, other)


def test_without_numba_numpy_compares_large_maps(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    assert in_phase._compiled.__wrapped__(4, is_noted=True) is None


def test_a_loop_is_compiled_once_on_a_machine(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    compiled, read = (_newly_compiled() for _ in range(2))
    assert not compiled.stats.cache_hits
    assert sum(read.stats.cache_hits.values()) == 1


def test_a_loop_is_compiled_where_it_cannot_be_kept_or_what_was_kept_is_damaged(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    _newly_compiled()
    kept = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert kept
    for path in kept:
        whole = path.read_bytes()
        for damaged in b"", whole[: len(whole) // 2]:
            path.write_bytes(damaged)
            assert not _newly_compiled().stats.cache_hits
        path.write_bytes(whole)
    monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])
    assert not _newly_compiled().stats.cache_hits


def _newly_compiled():
    """The loop for three radial components, of which no other test has one, after it has run."""
    loop = in_phase._compiled.__wrapped__(3, is_noted=False)
    assert loop is not None
    codes = np.full((3, 3, 1, 2), [1, 100], np.int8)
    one = np.ones((2, 3), np.float32)
    factor = np.ones((1, 2), np.float32)
    for array in codes, factor:
        array.flags.writeable = False
    found = np.zeros(2, np.float32)
    blocks = np.array([[0, 2]])
    loop(codes, one, one, factor, blocks, found, np.zeros(0, np.int8), np.empty(2, np.float32))
    np.testing.assert_allclose(found, [9.0, 900.0])
    return loop


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), k=st.integers(1, 20), alike=st.booleans())
def test_the_nearest_of_many_are_those_of_sorting_them(seed, k, alike):
    rng = np.random.default_rng(seed)
    distances = rng.random(100_000).astype(np.float32)
    if alike:
        distances = np.floor(distances * 10)
    distances[rng.random(100_000) < 0.5] = np.inf
    np.testing.assert_array_equal(nearest(distances, k), np.argsort(distances, kind="stable")[:k])


def test_a_large_map_keeps_nothing_decoded(monkeypatch):
    tensor_map = large(a_map(1), monkeypatch)
    for view in VIEWS:
        values = encode(images(1, 1)[0, 1][: view.rings], U[: view.rings, :4], 5)
        tensor_map.search_values(values, view).nearest(3)
        limited = tensor_map.seen_within(view.rings, 4)
        assert np.shares_memory(limited.stored.codes, tensor_map.stored.codes)
        for one in (tensor_map, limited):
            assert isinstance(one.renderings, CodedRenderings)
            assert not {"numbers", "_units", "_of_each"} & {*vars(one.renderings), *vars(one.seen)}


def test_each_reach_of_a_small_map_is_kept_and_none_of_them_decoded():
    tensor_map, view = a_map(1), View((3, 4))
    tensor_map.search_values(encode(images(1, 1)[0, 1], U[:, :4], 5), view).nearest(3)
    within = [tensor_map.seen_within(rings, 4) for rings in range(2, 8)]
    for rings, limited in enumerate(within, 2):
        values = encode(images(1, 1)[0, 1, :rings], U[:rings, :4], 5)
        tensor_map.search_values(values, replace(view, rings=rings)).nearest(3)
        assert tensor_map.seen_within(rings, 4) is limited
        assert np.shares_memory(limited.stored.codes, tensor_map.stored.codes)
        assert not {"numbers", "_units"} & set(vars(limited.renderings))
        assert limited.seen is tensor_map.seen


@pytest.mark.parametrize("hidden", [(), (3, 4), tuple(range(20))])
def test_within_some_rings_codes_are_compared_as_their_numbers(hidden):
    tensor_map = a_map(1)
    decoded = replace(tensor_map, stored=SignatureNumbers(tensor_map.signatures))
    for rings in 3, 5:
        values = encode(images(1, 40)[17, 2, :rings], U[:rings, :4], 5)
        found, expected = (
            one.search_values(values, View(hidden, rings)) for one in (tensor_map, decoded)
        )
        same(found.nearest(9), expected.nearest(9))
        np.testing.assert_allclose(
            found.distances_for_belief(), expected.distances_for_belief(), atol=1e-6
        )


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
    older = replace(other, stored=SignatureNumbers(other.signatures))
    start = np.array([0, 40, 80])
    joined = older.joined([one], start)
    assert isinstance(joined.stored, SignatureCodes)
    np.testing.assert_array_equal(joined.stored.codes[..., :40], other.stored.as_codes().codes)
    assert isinstance(older.joined([older], start).stored, SignatureNumbers)


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
