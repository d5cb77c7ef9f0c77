"""Processes that are forked from a clean one, which has no threads and holds no locks."""

import multiprocessing
import multiprocessing.util
import os
import tempfile
import threading
from multiprocessing.context import ForkServerContext

# The path of a Unix socket has at most 107 bytes; multiprocessing adds some 35 to the folder's.
_MOST_FOLDER_BYTES = 70
_SHORT_FOLDER = "/tmp"  # noqa: S108 - multiprocessing makes a private folder in it
_choosing = threading.Lock()


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
