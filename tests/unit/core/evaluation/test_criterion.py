"""Which answers are right, and which are of another pass."""

import numpy as np

from core.evaluation.criterion import Criterion
from tests.support.samples import straight_poses


def test_an_answer_is_of_another_pass_where_the_vehicle_left_the_place_in_between():
    poses = straight_poses(8)
    poses[:, 0] = [0.0, 1.0, 2.0, 30.0, 60.0, 30.0, 1.5, 0.5]
    criterion = Criterion(poses, np.arange(8.0))
    queried, answered = np.array([0, 7, 7, 0, 3]), np.array([1, 6, 0, 4, 5])
    assert criterion.right(queried, answered).tolist() == [True, True, True, False, True]
    assert criterion.other_pass(queried, answered).tolist() == [False, False, True, False, True]


def test_without_poses_no_answer_is_of_another_pass():
    criterion = Criterion(np.full((4, 7), np.nan), np.arange(4.0))
    assert criterion.other_pass(np.array([0, 0]), np.array([1, 3])).tolist() == [False, False]
