"""Processes of builds that do not build; each one imports this file, and nothing else of tests."""

import os
import time

__all__ = ["fall_over", "stand_still"]


def stand_still(*_: object) -> None:
    """Be a worker that never ends."""
    time.sleep(600)


def fall_over(*_: object) -> None:
    """Be a worker with a fault."""
    os._exit(3)
