"""Signals that stop a command: it ends after its cleanup."""

import signal
import sys
import time

_CLEANUP_S = 5.0


class _Stops:
    """Raises at the first signal; repeated ones do not interrupt the cleanup that follows.

    A hanging cleanup can still be interrupted: signals count again after five seconds. So does
    one whose first exception Python could not raise, as in a destructor.
    """

    def __init__(self) -> None:
        self._last_s: float | None = None

    def interrupt(self, _number: int, _frame: object) -> None:
        """Raise `KeyboardInterrupt`, as Python does for Ctrl-C."""
        if self._is_first():
            raise KeyboardInterrupt

    def terminate(self, number: int, _frame: object) -> None:
        """End the command with the status that shells have for the signal."""
        if self._is_first():
            sys.stderr.write("tensormap: stopped\n")
            sys.stderr.flush()
            sys.exit(128 + number)

    def _is_first(self) -> bool:
        time_s = time.monotonic()
        is_first = self._last_s is None or time_s - self._last_s > _CLEANUP_S
        if is_first:
            self._last_s = time_s
        return is_first


def stop_after_cleanup() -> None:
    """Let Ctrl-C, SIGTERM and the end of the terminal stop this process after its cleanup.

    By default the latter two end it at once, and a second Ctrl-C ends its cleanup. Signals that the
    caller ignores, as `nohup` does, stay ignored.
    """
    stops = _Stops()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stops.interrupt)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, stops.terminate)


def hangup_as_termination() -> None:
    """Stop a service whose terminal ends as SIGTERM does, unless its caller ignores that."""
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, lambda _number, _frame: signal.raise_signal(signal.SIGTERM))
