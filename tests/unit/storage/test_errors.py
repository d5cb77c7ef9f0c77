"""The storage branch of the error tree."""

import errno
import inspect

import pytest

from core.errors import TensorMapError
from storage import errors
from storage.errors import CorruptFile, StorageFull, StorageUnavailable, with_cause
from storage.files.files import named_disk_errors


def test_the_tree_draws_every_error():
    drawn = f" {errors.__doc__} ".replace("\n", " ")
    for name, error in inspect.getmembers(errors, inspect.isclass):
        assert issubclass(error, TensorMapError)
        assert f" {name} " in drawn


def test_the_cause_of_a_failing_disk_is_for_the_operator_only():
    cause = OSError(errno.ENOSPC, "No space left on device", "/data/maps/1")
    with pytest.raises(StorageFull) as raised, named_disk_errors():
        raise cause
    assert "/data" not in str(raised.value)
    assert with_cause(raised.value) == f"{raised.value} ({cause})"
    more = StorageFull(f"{raised.value}; 3 scans are stored")
    more.__cause__ = raised.value
    assert with_cause(more) == f"{more} ({cause})"


def test_the_cause_of_several_lines_is_one():
    failure = StorageUnavailable("the database cannot be reached")
    failure.__cause__ = ConnectionError("refused\n\tIs the server running?\n")
    assert with_cause(failure) == "the database cannot be reached (refused Is the server running?)"


def test_other_errors_have_their_cause_in_their_text():
    error = CorruptFile("a.h5 cannot be read")
    error.__cause__ = ValueError("a detail")
    assert with_cause(error) == "a.h5 cannot be read"
    assert with_cause(StorageFull("a scan needs more")) == "a scan needs more"
