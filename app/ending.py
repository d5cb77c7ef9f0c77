"""Ends background threads, and does not wait for one whose disk hangs."""

import logging
import threading

LONGEST_S = 5.0  # several parts end one after another, and a container is killed after 20 s

_log = logging.getLogger("tensormap.stop")


def end(thread: threading.Thread, within_s: float | None = None) -> None:
    """Wait until a thread has ended; if it does not, log its name and go on.

    Args:
        thread: One that was notified, and dies with the process; it may not have been started.
        within_s: The longest wait, `LONGEST_S` by default.
    """
    if thread.ident is None:
        return
    within_s = LONGEST_S if within_s is None else within_s
    thread.join(within_s)
    if thread.is_alive():
        _log.error("the %s did not end within %g s: the process ends it", thread.name, within_s)
