"""Set-up of our processes: threads, memory, files and garbage collection."""

import ctypes
import gc
import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from threadpoolctl import threadpool_limits

# Of glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_PR_SET_PDEATHSIG = 1  # of Linux' sys/prctl.h
_MEGABYTE = 2**20

_MIDDLE_PER_FULL = 50  # collections of 7,000 objects each; Python's own is 10
_LEAST_BY_DEFAULT_BYTES = 2**30
_SWITCH_S = 5e-4
_CGROUPS = Path("/sys/fs/cgroup")
_OUT_OF_MEMORY = Path("/proc/self/oom_score_adj")


def one_blas_thread() -> None:
    """Keep NumPy's and SciPy's BLAS to one thread for the rest of this process.

    The matrices here are small: more threads slow a query down (0.1 s instead of 6 ms to project
    a segment on two cores, measured) and make a sum depend on how many there are, so that the
    same drive would get another digest on another machine.
    """
    threadpool_limits(limits=1)
    # SciPy has a library of its own, which is loaded later, where it is first needed.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"


def private_files() -> None:
    """Let only this user read the files that this process creates."""
    os.umask(0o077)


def import_nothing_from_here() -> None:
    """Let Python processes that this one starts import no module of the current folder.

    A command does not either, but a process of multiprocessing looks there first, and so takes the
    package `app` of another project, in whose folder a service is started, for ours.
    """
    os.environ["PYTHONSAFEPATH"] = "1"  # as -P


def forget_variable(name: str) -> None:
    """Remove a variable from the environment of this process, and so of those that it starts.

    Its value is overwritten too: the system shows a process's first environment to every process of
    the same user, whatever was removed from it.
    """
    getenv = ctypes.CDLL(None).getenv
    getenv.restype = ctypes.c_void_p
    for found in [known for known in os.environ if known.upper() == name]:
        if value := getenv(os.fsencode(found)):
            ctypes.memset(value, 0, len(os.fsencode(os.environ[found])))
        del os.environ[found]


@contextmanager
def loading() -> Iterator[None]:
    """Collect no garbage while the block imports, and leave what it made out of later collections.

    Imports make many objects that stay: looking for cycles among them takes a sixth of their time.
    In a process that is forked later it would copy the pages that both share.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            collect_garbage_of_work()


def collect_garbage_of_work() -> None:
    """Collect garbage again where that was switched off: of what is made from now on."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def collect_seldom() -> None:
    """Make full garbage collections short and rare from now on.

    One visits every object that may be part of a cycle, and nothing else runs meanwhile: 0.2 s when
    all modules, routes and models are loaded, twice that with a thousand streams open, every few
    seconds (measured on two cores). The objects of now are excluded for good. A full collection
    runs after 350,000 objects more than were freed, not 70,000; young ones run as often as before.
    """
    gc.collect()
    gc.freeze()
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, _MIDDLE_PER_FULL)


def answer_beside_large_work() -> None:
    """Let a thread wait half a millisecond for another one's bytecode, not Python's five.

    An answer releases and takes the interpreter's lock dozens of times: once for each large array.
    While eight clients post the largest JSON, 99 of 100 fixes take a quarter less time (measured).
    """
    sys.setswitchinterval(_SWITCH_S)


def end_before_others() -> None:
    """Let Linux end this process, and not the service, when memory runs out.

    Without this it would end the largest one, which may be the service with its maps.
    """
    with suppress(OSError):  # another system, or forbidden: then the largest is ended
        _OUT_OF_MEMORY.write_text("1000")


def end_with_parent() -> None:
    """Let Linux stop this process, as SIGTERM does, when the one that started it has ended.

    That one has no cleanup of its own where it is killed.
    """
    prctl = getattr(ctypes.CDLL(None), "prctl", None)  # another system has none
    if prctl is not None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def keep_freed_memory() -> None:
    """Allocate arrays of a few megabytes from the memory of freed ones, up to 64 MB of it.

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


def limited_memory(limit_bytes: int) -> AbstractContextManager[None]:
    """Limit what this process allocates in the block: more raises `MemoryError`.

    Mapped files are not counted. A limit that the process has already is not raised; 0 sets no
    limit.
    """
    return _limited(resource.RLIMIT_DATA, limit_bytes or resource.RLIM_INFINITY)


def limited_files(limit_bytes: int) -> AbstractContextManager[None]:
    """Limit the length of files that this process writes in the block: more raises `OSError`."""
    return _limited(resource.RLIMIT_FSIZE, max(limit_bytes, 0))


@contextmanager
def _limited(kind: int, limit_bytes: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(kind)
    unlimited = resource.RLIM_INFINITY
    bounds = [bound for bound in (limit_bytes, soft, hard) if bound != unlimited]
    resource.setrlimit(kind, (min(bounds, default=unlimited), hard))
    try:
        yield
    finally:
        resource.setrlimit(kind, (soft, hard))


def most_build_memory_bytes(builds: int) -> int:
    """Return what each of so many builds at once may allocate; 1 GB at least.

    Together three quarters of the memory of this machine, or of its control group: the system would
    soon end a process that takes more, or slow everything down by paging.
    """
    has = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return max(min([has, *_group_limits()]) * 3 // 4 // builds, _LEAST_BY_DEFAULT_BYTES)


def _group_limits() -> Iterator[int]:
    """Return the limits of this process's control group and of those that it is in (version 2)."""
    try:
        own = Path("/proc/self/cgroup").read_text().strip().rpartition("::")[2]
    except OSError:
        return
    folder = _CGROUPS / own.lstrip("/")
    for group in (folder, *folder.parents):
        try:
            limit = (group / "memory.max").read_text().strip()
        except OSError:  # the root has none
            continue
        if limit.isdecimal():
            yield int(limit)
