"""The index of all places finds what comparing every place exactly finds."""

import functools
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from core.encodings.distance import Distance
from core.encodings.harmonic import in_phase, place_search
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.indexed_places import beside
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonic.place_index import HarmonicPlaceIndex
from core.encodings.harmonic.place_search import Effort
from core.encodings.harmonics import encode
from core.encodings.signature import Signature
from core.errors import InvalidMap
from core.parameters import MapParameters
from core.projection.imager import Image, Views
from core.projection.rings import RingGrid
from core.projection.small_image import small_image
from core.projection.visibility import View

PLACES = 50
RING_M = RingGrid().ring_m


@dataclass(frozen=True)
class City:
    """Some maps of one basis, their index, and all their places as one map."""

    index: HarmonicPlaceIndex
    models: list[HarmonicModel]
    whole: HarmonicModel


def images(seed, place, grid):
    """Return the images of a place from five viewpoints."""
    rng = np.random.default_rng([seed, place])
    return np.maximum(rng.normal(size=(5, *grid.shape)).cumsum(axis=-1), 0.0)


@functools.cache
def city(views, maps=4, seed=0, *, with_images=False):
    parameters = MapParameters.for_sensor(views=views)
    kept = parameters.encoder.kept_ranks(parameters)
    rng = np.random.default_rng(1)
    u = np.linalg.qr(rng.normal(size=(parameters.grid.rows, kept[0])))[0].astype(np.float32)
    models = []
    for number in range(maps):
        of_map = 100 * seed + number
        cells = np.stack([images(of_map, place, parameters.grid) for place in range(PLACES)])
        stored = encode(cells, u, kept[1])
        hidden = rng.integers(0, 2**12, (PLACES, 5)) if views == Views.ANY else None
        models.append(
            HarmonicModel(
                u,
                SignatureCodes.of(stored.astype(np.complex64)),
                np.array(parameters.lateral_renderings_m),
                np.array([0, PLACES]),
                parameters.grid.columns,
                Distance.NORMALISED,
                parameters.ranks,
                hidden,
                small_image(cells[:, 2]) if with_images else None,
                RING_M,
            )
        )
    whole = models[0].joined(models[1:], np.array([0, maps * PLACES]))
    return City(
        HarmonicPlaceIndex(HarmonicBasis.of(parameters, u)),
        models,
        whole,
    )


def scan(of, hidden, seed, place):
    rng = np.random.default_rng(seed)
    number, row = divmod(place, PLACES)
    grid = of.index.parameters.grid
    cells = images(number, row, grid)[2]
    cells = np.roll(cells, int(rng.integers(grid.columns)), axis=1)
    cells = np.maximum(cells + 0.1 * rng.normal(size=cells.shape), 0.0)
    cells[:, np.isin(np.arange(grid.columns) * 60 // grid.columns, hidden)] = -1.0
    return Image(cells.astype(np.float32), grid)


def query(of, view, seed, place):
    parameters = of.index.parameters
    r1, r2 = parameters.ranks
    rng = np.random.default_rng(seed)
    number, row = divmod(place, PLACES)
    cells = images(number, row, parameters.grid)[rng.integers(5)]
    cells = np.roll(cells, int(rng.integers(cells.shape[1])), axis=1)
    cells += rng.normal(size=cells.shape)
    hidden = np.isin(np.arange(cells.shape[1]) * 60 // cells.shape[1], view.hidden)
    cells[:, hidden] = 0.0
    near = slice(view.rings)
    values = encode(cells[near], of.index.basis.radial_basis[near, :r1], r2)
    return Signature(values.astype(np.complex64), None, "a" * 64, view=view)


def compare_few(patched, in_headings=100, exact=40):
    full_effort = Effort.of

    def effort(parameters, view):
        return full_effort(parameters, view)._replace(in_headings=in_headings, exact=exact)

    patched.setattr(Effort, "of", effort)
    patched.setattr(place_search, "_LEAST_CHOSEN", in_headings)
    patched.setattr(place_search, "_ALL_EXACT", 10)


@pytest.mark.parametrize("compiled", [False, True])
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000), place=st.integers(0, 4 * PLACES - 1))
def test_a_full_view_finds_the_nearest_of_all_places(compiled, seed, place):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(in_phase, "_LEAST_COMPILED", 0 if compiled else 10**9)
        compare_few(patched)
        for of in map(city, Views):
            asked = query(of, View(), seed, place)
            entries = [of.index.entries(of.models[:2]), of.index.entries(of.models[2:])]
            found = of.index.nearest(asked, [(one, None) for one in entries])
            exact = of.whole.search_values(asked.values, asked.view).distances()
            places = np.concatenate([found[0][0], found[1][0] + 2 * PLACES])
            distances = np.concatenate([found[0][1], found[1][1]])
            assert places[distances.argmin()] == exact.argmin()
            np.testing.assert_allclose(distances, exact[places], atol=1e-6)


@pytest.mark.parametrize("view", [View(), View(tuple(range(5, 25))), View((3, 4), rings=10)])
def test_of_few_places_all_are_compared_as_in_their_map(view):
    of = city(Views.ANY)
    asked = query(of, view, 3, 70)
    entries = of.index.entries(of.models)
    spans = np.array([[20, 30], [60, 80], [199, 200]])
    [(places, distances)] = of.index.nearest(asked, [(entries, spans)])
    assert places.tolist() == [*range(20, 30), *range(60, 80), 199]
    exact = of.whole.search_values(asked.values, asked.view).distances()
    np.testing.assert_allclose(distances, exact[places], atol=1e-6)


@pytest.mark.parametrize("hidden", [(), range(5, 25)])
@pytest.mark.parametrize("place", [0, 37, 85, 122, 199])
def test_a_scan_finds_the_place_that_its_cells_are_of(hidden, place):
    of = city(Views.ANY, with_images=True)
    asked = scan(of, hidden, 7, place)
    with pytest.MonkeyPatch.context() as patched:
        compare_few(patched, 190, 180)  # noise is alike in few headings
        entries = [of.index.entries(of.models[:2]), of.index.entries(of.models[2:])]
        found = of.index.nearest(asked, [(one, None) for one in entries])
    places = np.concatenate([found[0][0], found[1][0] + 2 * PLACES])
    distances = np.concatenate([found[0][1], found[1][1]])
    assert places[distances.argmin()] == place
    in_map = of.whole.search_image(asked, of.index.basis).distances_of(places)
    np.testing.assert_allclose(distances, in_map, atol=1e-5)


def test_where_a_place_has_no_image_a_scan_is_compared_by_its_numbers():
    of, without = city(Views.ANY, with_images=True), city(Views.ANY)
    asked = scan(of, range(5, 15), 2, 70)
    spans = np.array([[20, 30], [60, 80]])
    entries = [of.index.entries(of.models), without.index.entries(without.models)]
    found = of.index.nearest(asked, [(one, spans) for one in entries])
    basis = of.index.basis
    values = basis.encode(asked, basis.kept_ranks)[0].values
    for (places, distances), one in zip(found, (of, without), strict=True):
        exact = one.whole.search_values(values, asked.view).distances()
        np.testing.assert_allclose(distances, exact[places], atol=1e-6)


def test_a_basis_of_maps_without_images_keeps_none():
    of = city(Views.ANY, with_images=True)
    parameters = replace(of.index.parameters, verification_images=False)
    index = HarmonicPlaceIndex(HarmonicBasis.of(parameters, of.whole.radial_basis))
    entries = index.entries(of.models[:1])
    assert entries.images.shape == (PLACES, 0, 60)
    [(places, distances)] = index.nearest(scan(of, (), 1, 12), [(entries, None)])
    assert places[distances.argmin()] == 12


@given(
    values=st.lists(st.integers(-5, 5), min_size=1, max_size=300),
    count=st.integers(1, 300),
    sampled=st.integers(1, 60),
)
@example(values=[5, 0, 0, 0, 0] * 60, count=100, sampled=60)  # a sample of the largest alone
def test_the_most_of_many_values_are_the_largest(values, count, sampled):
    array = np.array(values, np.float32)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(place_search, "_SAMPLED", sampled)
        rows = place_search.most(array, count)
    assert len(set(rows.tolist())) == len(rows) == min(count, len(values))
    assert sorted(array[rows]) == sorted(values)[-count:]


def test_places_outside_the_ranges_change_nothing():
    of = city(Views.ANY)
    asked = query(of, View(tuple(range(10))), 4, 10)
    entries = of.index.entries(of.models)
    [(places, distances)] = of.index.nearest(asked, [(entries, np.array([[0, 100]]))])
    alone = of.index.entries(of.models[:2])
    [(of_alone, distances_alone)] = of.index.nearest(asked, [(alone, None)])
    np.testing.assert_array_equal(places, of_alone)
    np.testing.assert_allclose(distances, distances_alone, atol=1e-6)


def test_selected_and_joined_entries_keep_their_places():
    of = city(Views.ANY)
    entries = of.index.entries(of.models)
    some = entries.select(np.array([[50, 100], [150, 200]]))
    again = of.index.joined([of.index.entries([of.models[n]]) for n in (1, 3)])
    assert entries.select(np.array([[0, 4 * PLACES]])) is entries
    for name, array in some.arrays().items():
        np.testing.assert_array_equal(array, again.arrays()[name])


def test_numbers_of_an_older_map_are_indexed_as_codes():
    of = city(Views.ANY)
    older = of.models[0].stored.numbers
    again = HarmonicModel(
        of.whole.radial_basis,
        SignatureNumbers(older),
        of.models[0].lateral_offset_m,
        of.models[0].segment_start,
        of.models[0].columns,
        of.models[0].measure,
        of.models[0].sent_ranks,
        of.models[0].hidden_sectors,
    )
    one, other = of.index.entries(of.models[:1]), of.index.entries([again])
    np.testing.assert_array_equal(one.codes, other.codes)


def test_of_a_map_of_fewer_renderings_some_are_indexed_twice():
    model = city(Views.FULL).models[0]
    stored = SignatureNumbers(model.stored.numbers[:, :3])
    of_three = replace(model, stored=stored, lateral_offset_m=np.array([-1.5, 0.0, 1.5]))
    assert beside(of_three.lateral_offset_m).tolist() == [0, 0, 1, 2, 2]
    entries = city(Views.FULL).index.entries([of_three])
    np.testing.assert_array_equal(entries.codes[:, :, 0], entries.codes[:, :, 1])


def test_entries_that_do_not_fit_are_rejected():
    of = city(Views.ANY)
    arrays = of.index.entries(of.models[:1]).arrays()
    assert len(of.index.read(arrays)) == PLACES
    for name, array in arrays.items():
        with pytest.raises(InvalidMap, match="of an index"):
            of.index.read({**arrays, name: array[..., :-1]})
        with pytest.raises(InvalidMap, match=f"{name} of an index"):
            of.index.read({**arrays, name: array.astype(np.complex64)})


def test_without_numba_the_answer_is_the_same(monkeypatch):
    of = city(Views.ANY)
    asked = query(of, View(tuple(range(8))), 7, 120)
    entries = of.index.entries(of.models)
    monkeypatch.setattr(in_phase, "_LEAST_COMPILED", 0)
    in_phase._compiled.cache_clear()
    [(places, distances)] = of.index.nearest(asked, [(entries, None)])
    monkeypatch.setitem(sys.modules, "numba", None)
    in_phase._compiled.cache_clear()
    [(again, without)] = of.index.nearest(asked, [(entries, None)])
    in_phase._compiled.cache_clear()
    np.testing.assert_array_equal(places, again)
    np.testing.assert_allclose(distances, without, atol=1e-6)
