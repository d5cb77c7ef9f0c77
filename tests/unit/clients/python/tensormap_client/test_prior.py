"""What a vehicle knows of its place is checked before anything is sent."""

import numpy as np
import pytest
from tensormap_client import InvalidArgument
from tensormap_client.prior import require_prior


@pytest.mark.parametrize("segments", [[], (), np.array([], int)])
def test_a_prior_of_no_segment_is_not_sent_as_no_prior(segments) -> None:
    with pytest.raises(InvalidArgument, match="segment is empty, wanted at least one"):
        require_prior({"segment": segments})


@pytest.mark.parametrize("segments", [3, [3], np.int64(3), np.array(3), np.array([1, 2])])
def test_one_segment_or_several_are_a_prior(segments) -> None:
    require_prior({"segment": segments, "x_m": 1.0})


def test_a_value_that_is_not_known_is_left_out_by_the_caller() -> None:
    with pytest.raises(InvalidArgument, match="x_m is None: leave out what is not known"):
        require_prior({"x_m": None, "y_m": 1.0})


def test_a_set_of_segments_is_no_list_of_them() -> None:
    with pytest.raises(InvalidArgument, match=r"the set \{3\}, wanted a list"):
        require_prior({"segment": {3}})


def test_an_argument_that_is_none_of_a_prior_is_named() -> None:
    with pytest.raises(TypeError, match="no argument 'x_metres'"):
        require_prior({"x_metres": 1.0})
