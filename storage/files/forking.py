"""Processes that are forked from a clean one, which has no threads and holds no locks."""

import logging
import multiprocessing
import multiprocessing.util
import os
import tempfile
import threading
import time
from multiprocessing.context import ForkServerContext, ForkServerProcess

# The path of a Unix socket has at most 107 bytes; multiprocessing adds some 35 to the folder's.
_MOST_FOLDER_BYTES = 70
_SHORT_FOLDER = "/tmp"  # noqa: S108 - multiprocessing makes a private folder in it
_PAUSES_S = (0.1, 1.0)  # before a process is started again
_choosing = threading.Lock()
_log = logging.getLogger("tensormap.storage")


def forkserver() -> ForkServerContext:
    """Return the context of processes forked from a clean one, whatever TMPDIR is.

    Its socket is in the folder for temporary files: where that path is too long for a socket's,
    multiprocessing makes its folder in /tmp instead.
    """
    with _choosing:
        chosen = tempfile.gettempdir()
        if len(os.fsencode(chosen)) > _MOST_FOLDER_BYTES:
            try:
                tempfile.tempdir = _SHORT_FOLDER
                multiprocessing.util.get_temp_dir()  # it is made once
            finally:
                tempfile.tempdir = chosen
    return multiprocessing.get_context("forkserver")


def start_forked(process: ForkServerProcess) -> None:
    """Start a process, also if the one that forks it is killed meanwhile: another is made.

    Raises:
        OSError: If it cannot be started.
    """
    for pause_s in _PAUSES_S:
        try:
            process.start()
        except (EOFError, ConnectionError) as error:  # it ended; this is seen a moment later
            _log.warning("process %s is started again: %r", process.name, error)
            time.sleep(pause_s)
        else:
            return
    try:
        process.start()
    except EOFError as error:
        raise OSError(f"process {process.name} cannot be started: {error}") from error
