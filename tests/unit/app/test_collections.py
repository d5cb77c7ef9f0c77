"""What the garbage collector looks at in a service, and how often."""

import gc

from app.process import collect_seldom


def test_what_is_there_when_a_service_starts_is_left_out_of_collections() -> None:
    before = gc.get_threshold()
    loaded: list[list[int]] = [[]]
    try:
        collect_seldom()
        assert not any(found is loaded for found in gc.get_objects())
        later: list[list[int]] = [[]]
        assert any(found is later for found in gc.get_objects())
        assert gc.get_threshold() == (*before[:2], 50)
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()
