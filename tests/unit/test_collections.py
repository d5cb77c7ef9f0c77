"""What the garbage collector looks at in a service."""

import gc

from app.process import keep_for_ever


def test_what_is_there_when_a_service_starts_is_left_out_of_collections() -> None:
    loaded: list[list[int]] = [[]]
    try:
        keep_for_ever()
        assert not any(found is loaded for found in gc.get_objects())
        later: list[list[int]] = [[]]
        assert any(found is later for found in gc.get_objects())
    finally:
        gc.unfreeze()
