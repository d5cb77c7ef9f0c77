"""Checks every stored file regularly, so that damage is detected while there is a backup."""

import logging
import math
import threading
import time
from collections.abc import Collection
from pathlib import Path

from pydantic import BaseModel

from app.ending import end
from app.http.logs import fields
from app.http.metrics import Metrics
from app.outage import Outage
from storage.files.checker import Checker
from storage.files.files import publish
from storage.files.stored_file import Fault, StoredFile
from storage.store import Store
from storage.store.inventory import Inventory

_DAY_S = 86_400.0
_LONGEST_WAIT_S = 3600.0  # of a small store: its files are read more often than they must be
_RETRY_S = 60.0  # after the catalog could not be read
# Damaged files are checked again so often, for so long, whatever the pass: they may be mended.
_RECHECK_EVERY_S, _RECHECK_S = 3600.0, 60.0

_log = logging.getLogger("tensormap.scrub")


class _State(BaseModel):
    """Progress of a pass; stored, or a service that is often restarted would never end one.

    Attributes:
        after: Path of the file that was checked last.
        checked_at_s: When, in seconds since 1970.
        passed_at_s: When the last pass ended; before that, when the first one began, or 0 in a
            file of an earlier version.
        bad: What is wrong with each file that was damaged or missing when it was last checked.
    """

    after: str
    checked_at_s: float
    passed_at_s: float
    bad: dict[str, str]


class Scrub:
    """Checks one file at a time, spread over `days`, in a process of its own.

    A damaged file is logged and counted each time it is found, and not changed: requests for it
    fail with an error that names it, all others are answered. At a start and each hour the damaged
    ones are checked again: an alert would go on for a month after a repair.

    Args:
        store: The store with the files.
        metrics: The metrics that count checked files.
        days: Within which every file is checked once; 0 checks none.
    """

    def __init__(self, store: Store, metrics: Metrics, days: float) -> None:
        self._store = store
        self._inventory = Inventory(store.catalog, store.layout)
        self._metrics = metrics
        self._period_s = days * _DAY_S
        self._stopping = threading.Event()
        self._outage = Outage(_log, "the stored files cannot be checked now")
        self._checker: Checker | None = None  # while a file is checked
        self._rechecked_at_s = -math.inf
        self._thread = threading.Thread(target=self._loop, name="scrub", daemon=True)
        self._state_path: Path = store.layout.data_dir / "scrub.json"
        now_s = time.time()
        self._state = _State(after="", checked_at_s=now_s, passed_at_s=now_s, bad={})

    def start(self) -> None:
        """Continue where the last service stopped."""
        if self._period_s > 0.0:
            try:
                self._state = _State.model_validate_json(self._state_path.read_bytes())
            except FileNotFoundError:
                pass
            except (OSError, ValueError) as error:
                _log.warning("%s cannot be read, a new pass begins: %s", self._state_path, error)
            self._state.passed_at_s = self._state.passed_at_s or time.time()
            self._update_metrics()
            self._thread.start()

    def stop(self) -> None:
        """Stop; the current file is checked again after the next start."""
        self._stopping.set()
        checker = self._checker
        if checker is not None:  # to read a large file takes longer than a stop may
            checker.interrupt()
        end(self._thread)

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                self.run_pass()
            except Exception as error:  # noqa: BLE001 - the next pass must run after any error
                self._outage.failed(error)
                self._stopping.wait(_RETRY_S)

    def run_pass(self) -> None:
        """Check every file that was not yet checked in this pass, and end it."""
        paths = sorted(self._inventory.paths())
        sizes = [self._size_bytes(path) for path in paths]
        share_s = self._period_s / max(sum(sizes), 1)
        known = set(paths)
        self._recheck(known)
        for path, size_bytes in zip(paths, sizes, strict=True):
            if path <= self._state.after:
                continue
            self._recheck(known)
            if not self._wait(min(size_bytes * share_s, _LONGEST_WAIT_S)) or not self._check(path):
                return
            self._state.after, self._state.checked_at_s = path, time.time()
            self._save()
        if not sum(sizes) and not self._wait(min(self._period_s, _LONGEST_WAIT_S)):
            return
        self._state.bad = {path: what for path, what in self._state.bad.items() if path in known}
        self._state.after, self._state.passed_at_s = "", time.time()
        self._save()
        _log.info("pass ended", extra=fields(files=len(paths), damaged=len(self._state.bad)))

    def _wait(self, wait_s: float) -> bool:
        """Wait until so long after the last check; return whether the service still runs."""
        since_s = max(time.time() - self._state.checked_at_s, 0.0)  # clocks are set back
        return not self._stopping.wait(max(wait_s - since_s, 0.0))

    def _check(self, path: str) -> bool:
        """Check a file; return whether that was done, false if the service is stopping."""
        file = self._inventory.file(path)
        if file is None:  # deleted or moved since the pass began
            self._state.bad.pop(path, None)
            return True
        fault = None
        try:
            fault = self._fault(file)
            result = "good" if fault is None else "damaged" if fault.certain else "unreadable"
            what = "" if fault is None else fault.what
        except FileNotFoundError:
            result, what = "missing", "the file is gone"
        if self._stopping.is_set():  # the checking process may have been ended with this one
            return False
        self._metrics.scrubbed(result)
        if what:
            self._state.bad[path] = what
            described = self._inventory.described(file, fault)
            _log.error(
                "a stored file is damaged",
                extra=fields(file=path, of=described, found=result, what=what),
            )
        else:
            self._state.bad.pop(path, None)
        return True

    def _fault(self, file: StoredFile) -> Fault | None:
        with Checker() as self._checker:
            return self._inventory.fault(file, self._checker)

    def _is_bad(self, path: str) -> bool:
        file = self._inventory.file(path)
        try:
            return file is not None and self._fault(file) is not None
        except FileNotFoundError:
            return True

    def _recheck(self, known: Collection[str]) -> None:
        """Check the files again that were damaged, those first that were not checked for longest.

        Nothing is counted, and those that still are damaged are not logged: the pass does that.

        Args:
            known: The paths that the store had when the pass began, or went on.
        """
        began_s = time.monotonic()
        if self._stopping.is_set() or began_s - self._rechecked_at_s < _RECHECK_EVERY_S:
            return  # a checker that is opened after a stop would not be interrupted
        for path in tuple(self._state.bad):
            is_bad = path in known and self._is_bad(path)
            if self._stopping.is_set():  # the checking process may have been ended with this one
                return
            what = self._state.bad.pop(path)
            if is_bad:
                self._state.bad[path] = what  # as the last one
            else:
                self._save()
                _log.info("a stored file is damaged no longer", extra=fields(file=path))
            if time.monotonic() - began_s > _RECHECK_S:
                break
        self._rechecked_at_s = time.monotonic()

    def _save(self) -> None:
        self._update_metrics()
        with publish(self._state_path) as part:
            part.write_text(self._state.model_dump_json())
        self._outage.over()

    def _update_metrics(self) -> None:
        self._metrics.scrub_state(len(self._state.bad), self._state.passed_at_s)

    def _size_bytes(self, path: str) -> int:
        try:
            return (self._store.layout.data_dir / path).stat().st_size
        except OSError:
            return 0
