"""Waits between attempts double, and differ from client to client."""

import random

import pytest
from tensormap_client.waits import Waits


@pytest.fixture(params=[0.0, 1.0], ids=["shortest", "longest"])
def extreme(monkeypatch, request) -> float:
    """Draws the shortest or the longest of all waits."""
    share: float = request.param
    monkeypatch.setattr(random, "uniform", lambda low, high: low + share * (high - low))
    return share


def test_waits_double_up_to_the_longest_and_begin_again_after_an_answer(extreme) -> None:
    waits = Waits(0.25, 1.0)
    part = 0.5 + 0.5 * extreme
    assert [waits.next_s() for _ in range(4)] == [0.25 * part, 0.5 * part, part, part]
    waits.begin_again()
    assert waits.next_s() == 0.25 * part


def test_what_is_asked_for_is_waited_at_least_and_up_to_half_as_long_again(extreme) -> None:
    assert Waits(0.25, 1.0).next_s(8.0) == 8.0 + 4.0 * extreme


def test_clients_that_lost_a_service_together_return_apart() -> None:
    for asked_s in (0.0, 8.0):
        assert len({Waits(0.25, 1.0).next_s(asked_s) for _ in range(20)}) > 10
