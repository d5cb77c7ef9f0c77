"""Ends the parts of a service that stops, and does not wait for one whose disk hangs.

Where the system gives the process no thread to stop a part, it is stopped in turn, without a limit.

A container is killed 20 s after SIGTERM: the limits here add up to less.
"""

import logging
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping

ANSWERS_S = 10  # for unfinished answers
PARTS_S = 5.0  # for the parts with threads of their own, which stop at the same time
THREADS_S = 4.0  # of it for their threads
KILLED_S = 3.0  # of that for a process that one of these threads has killed
CLOSING_S = 2.0  # for the databases
LAST_S = 1.0  # for threads that still work on a request that was answered 503

_log = logging.getLogger("tensormap.stop")


def end(*threads: threading.Thread) -> None:
    """Wait until threads have ended; log the name of each that has not, and go on.

    Args:
        threads: They were notified, and die with the process; they may not have been started.
    """
    started = [thread for thread in threads if thread.ident is not None]
    for thread in _hung(started, THREADS_S):
        _log.error("the %s did not end within %g s: the process ends it", thread.name, THREADS_S)


def call_all(calls: Mapping[str, Callable[[], object]], within_s: float) -> None:
    """Call all at the same time; log each that fails or does not return in time, and go on.

    Those for which no thread can be started are called in turn, and waited for.

    Args:
        calls: What is called, by its name in the log.
        within_s: How long to wait for them.
    """
    threads = [
        threading.Thread(target=_call, args=(name, call), name=name, daemon=True)
        for name, call in calls.items()
    ]
    in_turn = []
    for thread in threads:
        try:
            thread.start()
        except RuntimeError:  # the system gives this process no more threads
            in_turn.append(thread)
    for thread in in_turn:
        thread.run()
    for thread in _hung([thread for thread in threads if thread not in in_turn], within_s):
        _log.error("%s did not end within %g s: the process ends it", thread.name, within_s)


def _call(name: str, call: Callable[[], object]) -> None:
    try:
        call()
    except Exception:  # noqa: BLE001 - the other parts must be stopped after any error
        _log.exception("%s cannot be stopped", name)


def end_hung_threads() -> None:
    """End this process, with status 1, if threads of requests do not end by themselves.

    Python would wait for them, whatever they wait for.
    """
    ours = threading.current_thread()
    waited_for = [one for one in threading.enumerate() if not one.daemon and one is not ours]
    hung = list(_hung(waited_for, LAST_S))
    for thread in hung:
        _log.error(
            "work on a request did not end within %g s%s: the process ends it",
            LAST_S,
            _place(thread),
        )
    if hung:
        os._exit(1)


def _hung(threads: Iterable[threading.Thread], within_s: float) -> Iterator[threading.Thread]:
    """Wait for threads; yield each that has not ended within so many seconds of the call."""
    deadline_s = time.monotonic() + within_s
    for thread in threads:
        thread.join(max(0.0, deadline_s - time.monotonic()))
        if thread.is_alive():
            yield thread


def _place(thread: threading.Thread) -> str:
    """Return where a thread is, if it still runs."""
    frame = sys._current_frames().get(thread.ident or 0)
    if frame is None:
        return ""
    last = traceback.extract_stack(frame)[-1]
    return f", in {last.name} ({last.filename}:{last.lineno})"
