"""Processes that are forked from a clean one, which has no threads and holds no locks."""

import logging
import multiprocessing
import multiprocessing.util
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.context import ForkServerContext, ForkServerProcess

from storage.errors import StorageUnavailable

# The path of a Unix socket has at most 107 bytes; multiprocessing adds some 35 to the folder's.
_MOST_FOLDER_BYTES = 70
_SHORT_FOLDER = "/tmp"  # noqa: S108 - multiprocessing makes a private folder in it
_PAUSES_S = (0.1, 1.0)  # before a process is started again
FORKER_KILLED = 255
"""Exit code that multiprocessing gives a process when the one that forked it was killed."""
_choosing = threading.Lock()
_log = logging.getLogger("tensormap.storage")


def forkserver() -> ForkServerContext:
    """Return the context of processes forked from a clean one, whatever TMPDIR is.

    Its socket is in the folder for temporary files: where that path is too long for a socket's,
    multiprocessing makes its folder in /tmp instead.

    Raises:
        StorageUnavailable: If no folder for temporary files can be written.
    """
    with _choosing:
        try:
            chosen = tempfile.gettempdir()
        except FileNotFoundError as error:  # as in a container that is read-only
            raise StorageUnavailable(
                f"{error.strerror}: make one of them writable, or set TMPDIR to a folder that is"
            ) from None
        if len(os.fsencode(chosen)) > _MOST_FOLDER_BYTES:
            try:
                tempfile.tempdir = _SHORT_FOLDER
                multiprocessing.util.get_temp_dir()  # it is made once
            finally:
                tempfile.tempdir = chosen
    return multiprocessing.get_context("forkserver")


def start_forked(make: Callable[[], ForkServerProcess]) -> ForkServerProcess:
    """Start a process; if the one that forks was killed meanwhile, start another one and try again.

    Where it was killed late, a first process may run already: `make` gives each one its own pipe,
    or the process ends by itself when nobody waits for it.

    Args:
        make: Returns the process, not started.

    Raises:
        OSError: If it cannot be started.
    """
    for pause_s in (*_PAUSES_S, None):
        process = make()
        try:
            process.start()
        except (EOFError, ConnectionError) as error:  # it ended; that is seen a moment later
            if pause_s is None:
                raise OSError(f"process {process.name} cannot be started: {error!r}") from error
            _log.warning("process %s is started again: %r", process.name, error)
            time.sleep(pause_s)
        else:
            break
    return process


def end_forked(process: ForkServerProcess, timeout_s: float) -> None:
    """Kill a process, and wait for its end.

    Where the process that forked it was killed, multiprocessing takes it for ended, and would
    leave it running: then it is killed by its number, and its end is not waited for.

    Args:
        process: A process that was started.
        timeout_s: How long to wait; afterwards `process.is_alive()` says whether it ended.
    """
    process.kill()
    if process.exitcode == FORKER_KILLED and process.pid is not None:
        with suppress(ProcessLookupError):  # it has ended by itself
            os.kill(process.pid, signal.SIGKILL)
    process.join(timeout_s)
