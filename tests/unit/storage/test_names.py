"""Slugs and ids."""

import pytest

from storage.errors import InvalidSlug
from storage.names import checked_slug, new_id


@pytest.mark.parametrize(
    "slug", ["a", "7", "campus-north", "2011_09_26_drive_0001", "v1.2", "x" * 64]
)
def test_a_slug_is_taken(slug):
    assert checked_slug(slug) == slug


@pytest.mark.parametrize(
    "slug",
    ["", "A", ".", "..", "../x", "a/b", "a b", "a%2f", "-a", "_a", "ä", "a\n", "a\0", "x" * 65],
)
def test_a_name_that_could_be_a_path_or_a_header_is_no_slug(slug):
    with pytest.raises(InvalidSlug):
        checked_slug(slug)


def test_ids_differ_and_are_hex():
    ids = {new_id() for _ in range(100)}
    assert len(ids) == 100
    assert all(len(bytes.fromhex(each)) == 16 for each in ids)
