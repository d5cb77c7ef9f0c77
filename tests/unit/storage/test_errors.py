"""The storage branch of the error tree."""

import inspect

from core.errors import TensorMapError
from storage import errors


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
