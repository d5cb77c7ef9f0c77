"""The storage branch of the error tree."""

import inspect

from core.errors import TensorMapError
from storage import errors


def test_the_tree_draws_every_error():
    drawn = f" {errors.__doc__} ".replace("\n", " ")
    for name, error in inspect.getmembers(errors, inspect.isclass):
        assert issubclass(error, TensorMapError)
        assert f" {name} " in drawn
