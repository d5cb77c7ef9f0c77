"""Small images are correlated where both scans see, as far as the query's returns reach."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.encodings.harmonic.small_query import SmallQuery
from core.projection.small_image import small_image
from core.projection.visibility import SECTORS, sector_of_column

RINGS, COLUMNS = 6, 120
ALL_HEADINGS = np.arange(SECTORS)[None]
PER_SECTOR = COLUMNS // SECTORS
some_sectors = st.sets(st.integers(0, SECTORS - 1), max_size=50)


def heights(seed, hidden=(), reach=RINGS):
    cells = np.random.default_rng(seed).uniform(0.1, 10.0, (RINGS, COLUMNS)).astype(np.float32)
    cells[reach:] = 0.0
    cells[:, np.isin(sector_of_column(COLUMNS), list(hidden))] = -1.0
    return cells


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    of_query=some_sectors,
    of_map=some_sectors,
    reach=st.integers(1, RINGS),
    turned=st.integers(0, SECTORS - 1),
)
def test_the_correlation_is_that_of_the_cells_that_both_see(seed, of_query, of_map, reach, turned):
    query = heights(seed, of_query, reach)
    stored = small_image(heights(seed + 1))
    seen = ~np.isin(np.arange(SECTORS), list(of_map))
    found = SmallQuery(query).correlation(
        stored[None, None].astype(np.float32), seen[None], ALL_HEADINGS
    )
    both = seen & np.roll(~np.isin(np.arange(SECTORS), list(of_query)), turned)
    if both.sum() >= 2:
        one = np.roll(small_image(query), turned, axis=1)[:reach, both].astype(float).ravel()
        other = stored[:reach, both].astype(float).ravel()
        expected = np.corrcoef(one, other)[0, 1]
        assert found[0, 0, turned] == pytest.approx(expected, abs=2e-3)


@given(seed=st.integers(0, 1000), turned=st.integers(0, SECTORS - 1))
@settings(max_examples=20, deadline=None)
def test_a_query_is_like_its_own_scan_in_its_own_heading(seed, turned):
    cells = heights(seed)
    stored = small_image(np.roll(cells, turned * PER_SECTOR, axis=1))
    views = stored[None, None].astype(np.float32)
    found = SmallQuery(cells).correlation(views, np.ones((1, SECTORS), bool), ALL_HEADINGS)[0, 0]
    assert found.argmax() == turned
    assert found[turned] == pytest.approx(1.0, abs=1e-4)
    assert np.abs(found).max() <= 1.0 + 1e-4


def test_where_nothing_is_seen_by_both_nothing_is_alike():
    half = range(SECTORS // 2)
    query = SmallQuery(heights(3, half))
    views = small_image(heights(3))[None, None].astype(np.float32)
    seen = np.isin(np.arange(SECTORS), half)
    assert query.correlation(views, seen[None], ALL_HEADINGS)[0, 0, 0] == pytest.approx(
        0.0, abs=1e-3
    )


def test_even_images_have_no_correlation():
    even = np.full((RINGS, COLUMNS), 2.0, np.float32)
    views = small_image(even)[None, None].astype(np.float32)
    found = SmallQuery(even).correlation(views, np.ones((1, SECTORS), bool), ALL_HEADINGS)
    assert np.abs(found).max() < 0.05


def test_some_headings_are_those_of_all():
    query = SmallQuery(heights(5, {3, 4}))
    views = small_image(np.stack([heights(seed) for seed in range(6)])).astype(np.float32)
    views, seen = views.reshape(3, 2, RINGS, SECTORS), np.ones((3, SECTORS), bool)
    seen[:, 40:] = False
    every = query.correlation(views, seen, np.tile(ALL_HEADINGS, (3, 1)))
    some = np.array([[59, 0, 1], [7, 8, 9], [30, 31, 32]])
    found = query.correlation(views, seen, some)
    np.testing.assert_allclose(found, np.take_along_axis(every, some[:, None], 2), atol=1e-5)
