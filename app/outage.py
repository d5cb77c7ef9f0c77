"""An outage: what fails again and again, as while a disk is full, is in the log once."""

import logging

from storage.errors import StorageError, with_cause


class Outage:
    """Logs the first failure of what is tried again, later ones of another cause, and the end.

    Args:
        log: Where they are logged.
        what: What fails, such as "the tracks cannot be saved".
    """

    def __init__(self, log: logging.Logger, what: str) -> None:
        self._log, self._what = log, what
        self._cause = ""

    def failed(self, error: Exception) -> None:
        """Log an error, unless the last attempt had the same."""
        cause = repr(error)
        if cause != self._cause:
            # Only a trace says where a fault of ours is; a full disk or a damaged file needs none.
            trace = None if isinstance(error, StorageError) else error
            self._log.error("%s: %s", self._what, with_cause(error), exc_info=trace)
        self._cause = cause

    def over(self) -> None:
        """Note an attempt that succeeded; after a failure it is logged."""
        if self._cause:
            self._log.info("this is over: %s", self._what)
        self._cause = ""
