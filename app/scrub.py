"""Reads every stored file now and then, so that damage is noticed while there is a backup."""

import json
import logging
import threading
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from app.http.logs import fields
from app.http.metrics import Metrics
from storage.files.checker import Checker
from storage.files.files import publish
from storage.store import Store
from storage.store.inventory import Inventory

_DAY_S = 86_400.0
_LONGEST_WAIT_S = 3600.0  # of a small store: its files are read more often than they must be
_END_S = 5.0  # that an end waits for the file at hand, which a disk may never give
_AGAIN_S = 60.0  # after the catalog could not be read

_log = logging.getLogger("tensormap.scrub")


@dataclass
class _State:
    """How far a pass is; kept on disk, or a service that is started often would never end one.

    Attributes:
        after: Path of the file that was checked last.
        checked_at_s: When, in seconds since 1970.
        passed_at_s: When the last pass ended, 0 before the first.
        bad: What is wrong with each file that was damaged or missing when it was last checked.
    """

    after: str = ""
    checked_at_s: float = field(default_factory=time.time)
    passed_at_s: float = 0.0
    bad: dict[str, str] = field(default_factory=dict)


class Scrub:
    """Checks one file at a time, spread over `days`, in a process of its own.

    What is damaged is logged by name and counted each time it is found, and otherwise left alone:
    what asks for it is refused by name, and all else is answered.

    Args:
        store: Whose files.
        metrics: Where they are counted.
        days: Within which every file is checked once; 0 checks none.
    """

    def __init__(self, store: Store, metrics: Metrics, days: float) -> None:
        self._store = store
        self._inventory = Inventory(store.catalog, store.layout)
        self._metrics = metrics
        self._period_s = days * _DAY_S
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="scrub", daemon=True)
        self._state_path: Path = store.layout.data_dir / "scrub.json"
        self._state = _State()

    def start(self) -> None:
        """Go on where the last service stopped."""
        if self._period_s > 0.0:
            self._state = _read(self._state_path)
            self._tell()
            self._thread.start()

    def stop(self) -> None:
        """End; the file at hand is checked again after the next start."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(_END_S)

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                self.run_pass()
            except Exception:  # noqa: BLE001 - whatever it is, the next pass is due
                _log.exception("the stored files cannot be checked now")
                self._stopping.wait(_AGAIN_S)

    def run_pass(self) -> None:
        """Check every file that was not yet checked in this pass, and end it."""
        paths = sorted(self._inventory.paths())
        sizes = [self._size_bytes(path) for path in paths]
        share_s = self._period_s / max(sum(sizes), 1)
        for path, size_bytes in zip(paths, sizes, strict=True):
            if path <= self._state.after:
                continue
            if not self._wait(min(size_bytes * share_s, _LONGEST_WAIT_S)) or not self._check(path):
                return
            self._state.after, self._state.checked_at_s = path, time.time()
            self._keep()
        if not sum(sizes) and not self._wait(min(self._period_s, _LONGEST_WAIT_S)):
            return
        there = set(paths)
        self._state.bad = {path: what for path, what in self._state.bad.items() if path in there}
        self._state.after, self._state.passed_at_s = "", time.time()
        self._keep()
        _log.info("pass ended", extra=fields(files=len(paths), damaged=len(self._state.bad)))

    def _wait(self, wait_s: float) -> bool:
        """Wait until so long after the file before; return whether the service still runs."""
        since_s = max(time.time() - self._state.checked_at_s, 0.0)  # clocks are set back
        return not self._stopping.wait(max(wait_s - since_s, 0.0))

    def _check(self, path: str) -> bool:
        """Check a file; return whether it was, which it was not if the service is to end."""
        file = self._inventory.file(path)
        if file is None:  # deleted or moved since the pass began
            self._state.bad.pop(path, None)
            return True
        fault = None
        try:
            with Checker() as checker:
                fault = self._inventory.fault(file, checker)
            result = "good" if fault is None else "damaged" if fault.certain else "unreadable"
            what = "" if fault is None else fault.what
        except FileNotFoundError:
            result, what = "missing", "the file is gone"
        if self._stopping.is_set():  # its process may have been ended with ours
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

    def _keep(self) -> None:
        self._tell()
        with publish(self._state_path) as part:
            part.write_text(json.dumps(asdict(self._state)))

    def _tell(self) -> None:
        self._metrics.scrub_state(len(self._state.bad), self._state.passed_at_s)

    def _size_bytes(self, path: str) -> int:
        try:
            return (self._store.layout.data_dir / path).stat().st_size
        except OSError:
            return 0


def _read(path: Path) -> _State:
    """Return the state that was kept; where there is none, or none that can be read, a new one."""
    try:
        kept = json.loads(path.read_bytes())
        bad = {str(file): str(what) for file, what in kept["bad"].items()}
        return _State(
            str(kept["after"]), float(kept["checked_at_s"]), float(kept["passed_at_s"]), bad
        )
    except FileNotFoundError:
        return _State()
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        _log.warning("%s cannot be read, a new pass begins: %s", path, error)
        return _State()
