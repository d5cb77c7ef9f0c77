"""Whether the service can do its work: what its parts lack."""

import logging

from app.jobs.runner import JobRunner
from app.outage import Outage
from core.errors import TensorMapError
from storage.store import Store

_UNREADABLE = "the catalog cannot be read"

_log = logging.getLogger("tensormap.health")


class Readiness:
    """What a service lacks; an outage of the catalog is logged once, however often a probe looks.

    Args:
        store: The service's store.
        runner: Its builds.
    """

    def __init__(self, store: Store, runner: JobRunner) -> None:
        self._store, self._runner = store, runner
        self._outage = Outage(_log, _UNREADABLE)

    def lacking(self) -> list[str]:
        """Return why maps cannot be read or written, or builds do not run; empty if all do."""
        found = []
        try:
            self._store.maps.list(limit=1)
        except TensorMapError as error:
            self._outage.failed(error)
            found.append(f"{_UNREADABLE}: {error}")
        else:
            self._outage.over()
        found += self._store.lacking()
        if not self._runner.alive:
            found.append("builds do not run")
        return found
