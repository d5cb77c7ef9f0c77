"""Results that are kept for the objects they were computed of."""

from app.localization import derived
from app.localization.derived import Derived


def counted():
    calls = []

    def length(values):
        calls.append(values)
        return len(values)

    return calls, length


def test_a_result_is_computed_once_for_the_same_objects():
    (calls, length), kept, values = counted(), Derived(), [1, 2]
    assert [kept.of(length, values) for _ in range(3)] == [2, 2, 2]
    assert len(calls) == 1


def test_equal_objects_are_others():
    (calls, length), kept = counted(), Derived()
    assert [kept.of(length, [1, 2]) for _ in range(3)] == [2, 2, 2]
    assert len(calls) == 3


def test_only_some_results_are_kept(monkeypatch):
    monkeypatch.setattr(derived, "_KEPT", 2)
    (calls, length), kept = counted(), Derived()
    one, two, three = [1], [1, 2], [1, 2, 3]
    for values in (one, two, three, two, three, one):
        assert kept.of(length, values) == len(values)
    assert calls == [one, two, three, one]


def test_a_result_that_is_used_again_is_kept_longer(monkeypatch):
    monkeypatch.setattr(derived, "_KEPT", 2)
    (calls, length), kept = counted(), Derived()
    one, two, three = [1], [1, 2], [1, 2, 3]
    for values in (one, two, one, three, one, two):
        assert kept.of(length, values) == len(values)
    assert calls == [one, two, three, two]
