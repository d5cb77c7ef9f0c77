"""What builds are forked from, itself forked from a process that has imported what builds need."""

import multiprocessing.forkserver
import multiprocessing.resource_tracker
import multiprocessing.util
import os
import signal
from collections.abc import Sequence
from itertools import pairwise
from unittest import mock

__all__ = ["fork_builds"]


def fork_builds() -> None:
    """Start what this process forks its builds from now, forked: it would import all of it anew."""
    with mock.patch.object(multiprocessing.util, "spawnv_passfds", _fork_instead):
        multiprocessing.resource_tracker.ensure_running()
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        multiprocessing.forkserver.ensure_running()  # deaf, as when app.builds.runner starts it
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _fork_instead(_python: str, words: Sequence[str], files: Sequence[int]) -> int:
    """As `spawnv_passfds` of multiprocessing, in a process that need not import what words run."""
    forked = os.fork()
    if forked == 0:
        try:
            for kept, next_kept in pairwise([2, *sorted(files), os.sysconf("SC_OPEN_MAX")]):
                os.closerange(kept + 1, next_kept)
            exec(words[-1], {})
        finally:
            os._exit(0)
    return forked
