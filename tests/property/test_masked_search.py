"""A signature of a part of a place is compared with what its scan would have seen of a map."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from core.encodings.distance import Distance
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonics import azimuth_factor, encode, energy, two_sided
from core.encodings.signature import Packing, Signature, pack_signatures, unpack_signatures
from core.errors import InvalidSignature
from core.projection.visibility import (
    MOST_RINGS,
    SECTORS,
    View,
    bits_of_hidden,
    hidden_sectors,
    hide,
    sector_of_column,
)

COLUMNS, SENT, KEPT = 120, 5, 12
U = np.linalg.qr(np.random.default_rng(1).normal(size=(8, 4)))[0].astype(np.float32)


def some_hidden(most=45):
    return st.sets(st.integers(0, SECTORS - 1), max_size=most).map(lambda s: tuple(sorted(s)))


def a_map(seed, hidden_of_map=None, scans=9):
    rng = np.random.default_rng(seed)
    images = np.maximum(rng.normal(size=(scans, 3, 8, COLUMNS)).cumsum(axis=-1), 0.0)
    signatures = SignatureNumbers(encode(images, U, KEPT).astype(np.complex64))
    hidden = np.zeros((scans, 3), np.int64) if hidden_of_map is None else hidden_of_map
    offsets_m, start = np.array([-2.0, 0.0, 2.0]), np.array([0, scans])
    return HarmonicModel(
        U, signatures, offsets_m, start, COLUMNS, Distance.NORMALISED, (4, SENT), hidden
    )


def as_columns(signatures):
    """Return what kept harmonics say of the columns, `(..., r1, J)`."""
    factor = azimuth_factor(COLUMNS, KEPT).conj()
    pairs = np.where(np.arange(KEPT) > 0, 2.0, 1.0)
    return np.real(signatures.astype(np.complex128) * pairs @ factor.T)


def products_in_window(hidden):
    """Return the weights of `q* A p`, of two-sided q and p in the columns that are not hidden."""
    visible = ~np.isin(sector_of_column(COLUMNS), hidden)
    apart = np.arange(1 - SENT, SENT)[:, None] - np.arange(1 - SENT, SENT)
    left = (np.exp(-2j * np.pi / COLUMNS * apart[..., None] * np.arange(COLUMNS)) * visible).mean(
        -1
    )
    return np.linalg.inv(left + 0.005 * np.eye(2 * SENT - 1))


def seen(columns, hidden, turned=0):
    """Return the sent harmonics of what a scan sees of columns that are turned."""
    visible = ~np.isin(sector_of_column(COLUMNS), hidden)
    return encode(np.roll(columns, turned, axis=-1) * visible, np.eye(4), SENT)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), hidden=st.sampled_from([10, 20, 30, 45]))
@example(seed=24, hidden=30)  # by six waves the window leaves less than nothing of it
def test_scans_that_see_little_are_estimated_no_nearer_than_they_can_be(seed, hidden):
    rng = np.random.default_rng(seed)
    images = np.zeros((9, 3, 8, COLUMNS))
    images[..., :3] = rng.random((9, 3, 8, 3))
    signatures = SignatureNumbers(encode(images, U, KEPT).astype(np.complex64))
    values = rng.normal(size=(4, KEPT)) + 1j * rng.normal(size=(4, KEPT))
    search = replace(a_map(seed), stored=signatures).search_values(
        values, View(tuple(range(hidden)))
    )
    assert np.abs(search._squared_scores).max() < 1.0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), hidden=some_hidden(), turned=st.integers(0, COLUMNS - 1))
def test_the_distance_is_that_of_the_definition(seed, hidden, turned):
    model = a_map(seed)
    query = seen(as_columns(model.signatures[4, 1]), hidden, turned)
    assume(energy(query, COLUMNS) > 1e-3)
    distances, _ = model.search_values(query, View(hidden)).exact(np.arange(len(model)))
    inner = products_in_window(hidden)
    of_query = two_sided(query) @ inner.T
    for row, rendering in ((4, 1), (7, 0)):
        columns = as_columns(model.signatures[row, rendering])
        turns = (np.arange(COLUMNS) - np.arange(COLUMNS)[:, None]) % COLUMNS
        others = two_sided(seen(columns[:, turns].transpose(1, 0, 2), hidden))
        of_others = np.real(others.conj() * (others @ inner.T)).sum(axis=(1, 2))
        both = np.sqrt(np.real(two_sided(query).conj() * of_query).sum() * of_others)
        scores = np.real(of_query * others.conj()).sum(axis=(1, 2)) / np.maximum(both, 1e-9)
        # Between the headings that were tried a peak can be a little higher.
        assert 1.0 - distances[row, rendering] == pytest.approx(scores.max(), abs=0.03)
    assert distances[4, 1] < 1e-3  # a parabola between 128 headings
    if len(hidden) < 30:
        found = model.search_values(query, View(hidden)).nearest(1)
        assert (found.rows[0], found.lateral_m[0]) == (4, 0.0)
        expected = turned * 360.0 / COLUMNS
        assert abs((found.relative_yaw_deg[0] + expected + 180.0) % 360.0 - 180.0) < 1.0


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), hidden=some_hidden(30))
def test_images_of_few_harmonics_are_as_alike_as_in_the_columns_that_are_seen(seed, hidden):
    model = a_map(seed)
    few = model.signatures.copy()
    few[..., 3:] = 0.0
    model = replace(model, stored=SignatureNumbers(few))
    visible = ~np.isin(sector_of_column(COLUMNS), hidden)
    columns = as_columns(few[:, 1]) * visible
    query = encode(columns[4], np.eye(4), SENT)
    search = model.search_values(query, View(hidden))
    at_no_turn = search.viewpoints(np.arange(len(model)), np.zeros(len(model)))
    alike = at_no_turn.renderings[1, :, 1] @ at_no_turn.query
    alike /= np.linalg.norm(at_no_turn.renderings[1, :, 1], axis=-1)
    of_columns = np.einsum("rj,nrj->n", columns[4], columns) / np.linalg.norm(columns, axis=(1, 2))
    both = np.linalg.norm(at_no_turn.query), np.linalg.norm(columns[4])
    np.testing.assert_allclose(alike / both[0], of_columns / both[1], atol=0.02)


@pytest.mark.parametrize("hidden", [(), (3, 4, 5, 6)])
def test_distances_for_a_belief_are_exact_of_the_nearest_and_of_one_rendering_of_others(hidden):
    model = a_map(5, scans=60)
    search = model.search_values(seen(as_columns(model.signatures[31, 1]), hidden), View(hidden))
    exact, found = search.distances(), search.distances_for_belief()
    assert (exact.argmin(), found.argmin()) == (31, 31)
    near = np.argsort(found)[:24]
    np.testing.assert_allclose(found[near], exact[near], atol=1e-6)
    assert (found >= exact - 1e-6).all()
    assert np.median(found - exact) < 1e-3
    of_each, _ = search.exact(np.arange(60))
    assert np.isclose(found[:, None], of_each, atol=1e-6).any(axis=1).all()


def of_whole_view(seed, sent, *, known, blind):
    """Return the search of a query from beside a scan, or of none, in a map that may be blind."""
    rng = np.random.default_rng(seed)
    hidden = rng.integers(0, 2**60, (60, 3)) * (rng.random((60, 3)) < 0.3) if blind else None
    model = a_map(seed, hidden, scans=60)
    columns = as_columns(model.signatures[17, 1] if known else a_map(seed + 5000).signatures[0, 0])
    noise = columns.std() * rng.normal(size=columns.shape)
    return model, encode(columns + noise, np.eye(4), sent)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000), sent=st.integers(1, KEPT), known=st.booleans(), blind=st.booleans()
)
def test_no_scan_is_nearer_to_a_whole_view_than_its_bound(seed, sent, known, blind):
    model, query = of_whole_view(seed, sent, known=known, blind=blind)
    search, rows = model.search_values(query), np.arange(60)
    assert (search._least_distances_of(rows) <= search.exact(rows)[0].min(axis=1)).all()


@pytest.mark.parametrize("seed", range(20))
def test_few_scans_may_be_nearer_to_a_view_with_little_hidden_than_the_right_one(seed):
    first, width = np.random.default_rng(seed).integers([0, 1], [SECTORS, 13]).tolist()
    hidden = tuple(sorted((first + at) % SECTORS for at in range(width)))
    model = a_map(seed, scans=60)
    noise = 0.3 * np.random.default_rng(seed).normal(size=(4, COLUMNS))
    query = seen(as_columns(model.signatures[17, 1]) + noise, hidden, turned=30)
    search = model.search_values(query, View(hidden))
    least, exact = search.least_distances(), search.exact(np.arange(60))[0].min(axis=1)
    assert exact.argmin() == 17
    assert np.median(least - exact) < 0.0
    assert np.count_nonzero(least < max(least[17], exact[17])) < 8  # so many are compared


@pytest.mark.parametrize("width", [13, 40])
def test_the_least_distances_to_a_view_with_much_hidden_are_estimates(width):
    model, hidden = a_map(3, scans=60), tuple(range(width))
    search = model.search_values(seen(as_columns(model.signatures[17, 1]), hidden), View(hidden))
    assert search.least_distances() is search._estimates


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000), known=st.booleans(), blind=st.booleans(), k=st.integers(1, 9))
def test_the_nearest_of_a_whole_view_are_those_of_comparing_all_that_are_preferred(
    seed, known, blind, k
):
    model, query = of_whole_view(seed, SENT, known=known, blind=blind)
    search = model.search_values(query)
    rows = np.sort(search._preferred(k, None))
    wanted, found = search.ranked(rows, *search.exact(rows), k), search.nearest(k)
    np.testing.assert_array_equal(found.rows, wanted.rows)
    np.testing.assert_allclose(found.distances, wanted.distances, atol=1e-6)
    np.testing.assert_allclose(found.relative_yaw_deg, wanted.relative_yaw_deg, atol=1e-2)
    np.testing.assert_array_equal(found.lateral_m, wanted.lateral_m)


def test_a_scan_that_is_given_twice_does_not_change_the_distances_of_others():
    model = a_map(3)
    search = model.search_values(seen(as_columns(model.signatures[4, 1]), ()))
    twice, again = search.distances_of(np.array([5, 5, 3])), search.distances_of(np.array([7, 3]))
    alone = search.exact(np.array([5, 3, 7]))[0].min(axis=1)
    np.testing.assert_allclose(twice, alone[[0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(again, alone[[2, 1]], atol=1e-6)


@pytest.mark.parametrize("hidden", [(), (3, 4, 5, 6)])
def test_expected_scans_are_compared_once_and_together_with_the_next_ones(hidden, monkeypatch):
    model, hidden_view = a_map(3), View(hidden)
    query = seen(as_columns(model.signatures[4, 1]), hidden)
    search, compared = model.search_values(query, hidden_view), []
    exact = search.exact

    def noted(rows):
        compared.append(rows.tolist())
        return exact(rows)

    monkeypatch.setattr(search, "exact", noted)
    search.expect(np.array([2, 6]))
    search.compared(np.array([1, 2]))
    distances = search.distances_of(np.array([2, 6]))
    assert compared == [[1, 2, 6]]
    alone = model.search_values(query, hidden_view).exact(np.array([2, 6]))[0]
    np.testing.assert_allclose(distances, alone.min(axis=1), rtol=1e-6, atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), sent=st.integers(2, KEPT))
def test_where_nothing_is_hidden_it_is_the_distance_of_full_views(seed, sent):
    model = a_map(seed)
    query = encode(np.random.default_rng(seed).random((4, COLUMNS)), np.eye(4), sent)
    start, offsets_m = model.segment_start, model.lateral_offset_m
    cut = SignatureNumbers(model.signatures[..., :sent])
    full = HarmonicModel(U, cut, offsets_m, start, COLUMNS, Distance.NORMALISED, (4, sent))
    rows = np.arange(len(model))
    masked, _ = model.search_values(query).exact(rows)
    np.testing.assert_allclose(masked, full.search_values(query).exact(rows)[0], atol=2e-3)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), sent=st.integers(1, KEPT))
def test_no_heading_of_a_full_view_scores_more_than_all_waves_in_phase(seed, sent):
    model = a_map(seed)
    query = encode(np.random.default_rng(seed).random((4, COLUMNS)), np.eye(4), sent)
    search = model.search_values(query)
    distances, _ = search.exact(np.arange(len(model)))
    share = model.renderings.energy_share(sent).reshape(distances.shape[::-1])
    floored = np.sqrt(np.maximum(share, 0.02) / (share + 0.02))
    assert ((1.0 - distances.T) * floored <= search._phase_free_scores + 1e-4).all()


def test_what_a_rendering_does_not_see_counts_less_against_it():
    bits = np.zeros((9, 3), np.int64)
    bits[4, 1] = (1 << 30) - 1  # half of the circle
    model = a_map(3, bits)
    whole = as_columns(model.signatures[4, 1]).copy()
    whole[:, : COLUMNS // 2] += 3.0  # where the rendering is blind, the query has something
    query = encode(whole, np.eye(4), SENT)
    blind = model.search_values(query).exact(np.array([4]))[0][0, 1]
    sighted = a_map(3).search_values(query).exact(np.array([4]))[0][0, 1]
    assert blind < sighted


@pytest.mark.parametrize("seed", range(5))
def test_estimates_count_what_a_rendering_does_not_see_as_exact_scores_do(seed):
    sighted, blind = a_map(seed), a_map(seed, np.full((9, 3), (1 << 45) - 1))
    narrow = tuple(range(20, SECTORS))  # so that much of the query is where the map is blind
    query = seen(as_columns(sighted.signatures[4, 1]), narrow)
    others, ratios = np.array([0, 1, 2, 3, 5, 6, 7, 8]), []
    for search in (model.search_values(query, View(narrow)) for model in (sighted, blind)):
        exact = 1.0 - search.exact(others)[0].min(axis=1)
        ratios.append(exact / (1.0 - search._estimates[others]))
    whole = exact < 0.9  # beyond, the distance would become less than half, and estimates may err
    assert whole.sum() >= 4
    assert np.median(np.abs(ratios[0] / ratios[1] - 1.0)[whole]) < 0.004


@pytest.mark.parametrize("seed", range(5))
def test_what_a_rendering_does_not_see_makes_no_two_equal_that_are_not(seed):
    blind = a_map(seed, np.full((9, 3), (1 << 45) - 1))
    narrow = View(tuple(range(12, SECTORS)))
    query = seen(as_columns(blind.signatures[4, 1]), narrow.hidden)
    distances, _ = blind.search_values(query, narrow).exact(np.array([0, 1, 2, 3, 5, 6, 7, 8]))
    assert distances.min() > 1e-4


@given(
    view=st.builds(View, some_hidden(SECTORS - 1), st.none() | st.integers(1, MOST_RINGS)),
    packing=st.sampled_from(Packing),
    ranks=st.sampled_from([(5, 5), (6, 7), (8, 5)]),
)
def test_a_partial_view_survives_the_wire_in_eight_bytes(view, packing, ranks):
    rng = np.random.default_rng(0)
    values = (rng.normal(size=ranks) + 1j * rng.normal(size=ranks)).astype(np.complex64)
    values.imag[:, 0] = 0.0
    signature = Signature(values, None, "0f" * 32, view=view)
    packed = pack_signatures([signature], packing)
    plain = pack_signatures([Signature(values, None, "0f" * 32)], packing)
    shorter = 2 if packing == Packing.INT8 else 0  # of the scale
    assert len(packed) - len(plain) == (0 if view.is_full else 8 - shorter)
    assert packing == Packing.FLOAT16 or len(packed) <= 100
    [again] = unpack_signatures(packed)
    assert again.view == view
    step = np.abs(values).max() * 2 / 127
    np.testing.assert_allclose(again.values, values, atol=step)


@given(seed=st.integers(0, 1000), rings=st.integers(2, 7), r1=st.integers(2, 4))
def test_a_scan_of_short_reach_is_compared_with_the_rings_within_it(seed, rings, r1):
    model = a_map(seed)
    whole = U @ as_columns(model.signatures[4, 1])  # an image that the basis describes wholly
    query = encode(whole[:rings], U[:rings, :r1], SENT)
    distances, _ = model.search_values(query, View(rings=rings)).exact(np.arange(len(model)))
    assert distances[4, 1] < 1e-4
    assert distances[4, 1] == distances.min()


@pytest.mark.parametrize("rings", [0, -1, 16, 1.5])
def test_rings_that_cannot_be_are_rejected(rings):
    with pytest.raises((InvalidSignature, TypeError), match=r"rings is .*wanted 1\.\.15|integer"):
        View(rings=rings)


@pytest.mark.parametrize("hidden", [range(SECTORS), (60,), (-1,), (3, 3), (4, 3)])
def test_hidden_sectors_that_cannot_be_are_rejected(hidden):
    with pytest.raises(InvalidSignature, match=r"sectors? "):
        View(tuple(hidden))


def test_a_map_of_full_views_rejects_a_signature_of_a_part():
    model = a_map(1)
    full = HarmonicModel(
        U,
        model.stored,
        model.lateral_offset_m,
        model.segment_start,
        COLUMNS,
        model.measure,
        (4, KEPT),
    )
    query = Signature(model.signatures[0, 0], None, "0f" * 32, view=View((1, 2)))
    with pytest.raises(InvalidSignature, match=r"2 sectors are hidden.* views = any"):
        full.search([query])


@given(hidden=some_hidden(SECTORS), columns=st.sampled_from([60, 72, 360, 720]))
def test_marked_columns_name_their_sectors_again(hidden, columns):
    visible = ~np.isin(np.arange(SECTORS), hidden)
    cells = hide(np.ones((3, columns), np.float32), visible)
    assert hidden_sectors(cells) == hidden
    assert int(bits_of_hidden(cells)) == sum(1 << sector for sector in hidden)
