"""Slugs, and the storage branch of the error tree."""

import inspect

import pytest

from core.errors import TensorMapError
from storage import errors
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
def test_what_could_be_a_path_or_a_header_is_no_slug(slug):
    with pytest.raises(InvalidSlug):
        checked_slug(slug)


def test_ids_differ_and_are_hex():
    ids = {new_id() for _ in range(100)}
    assert len(ids) == 100
    assert all(len(bytes.fromhex(each)) == 16 for each in ids)


def test_all_lists_every_error_in_order_and_the_tree_draws_it():
    defined = [
        name
        for name, value in vars(errors).items()
        if inspect.isclass(value) and value.__module__ == errors.__name__
    ]
    assert sorted(defined) == errors.__all__
    for name in errors.__all__:
        assert issubclass(getattr(errors, name), TensorMapError)
        assert f" {name} " in f" {errors.__doc__} ".replace("\n", " ")
