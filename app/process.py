"""What processes of ours set up before they compute."""

import ctypes
import os

from threadpoolctl import threadpool_limits

__all__ = ["keep_freed_memory", "one_blas_thread", "private_files"]

# Of glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_MEGABYTE = 2**20


def one_blas_thread() -> None:
    """Keep NumPy's and SciPy's BLAS to one thread for the rest of this process.

    The matrices here are small: more threads slow a query down (0.1 s instead of 6 ms to project
    a segment on two cores, measured) and make a sum depend on how many there are, so that the
    same drive would get another digest on another machine.
    """
    threadpool_limits(limits=1)


def private_files() -> None:
    """Let files that this process makes be its user's, and nobody else's."""
    os.umask(0o077)


def keep_freed_memory() -> None:
    """Let arrays of a few megabytes come from memory that earlier ones left, up to 64 MB of it.

    For a process that computes in one thread: glibc gives such memory back to the system at once,
    and the system clears it page by page for the next array, half of the time that it takes to
    simulate a scan and a tenth of a build's (measured on a virtual machine). Not for a service: in
    its many threads an answer takes a tenth more (measured). With another C library, and where the
    operator has set up glibc's own, nothing is changed.
    """
    if any(name == "GLIBC_TUNABLES" or name.startswith("MALLOC_") for name in os.environ):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 16 * _MEGABYTE)
        mallopt(_M_TRIM_THRESHOLD, 64 * _MEGABYTE)
