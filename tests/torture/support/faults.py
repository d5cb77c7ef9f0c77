"""Disk faults: writes, syncs and renames of a running service that fail on command.

`faults.c`, preloaded into every process of the service, counts such calls on files of one folder in
a file that the tests map too. It is built where a C compiler is.
"""

import ctypes
import errno
import mmap
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

OPERATIONS = ("open", "write", "sync", "rename", "truncate", "mkdir")
_SOURCE = Path(__file__).with_name("faults.c")
_NOTES, _NOTE = 512, 320
_EVER = 2**63
_LIFT_S = 3.0


class _Control(ctypes.Structure):
    """As `struct control` of faults.c."""

    _fields_ = (
        ("armed", ctypes.c_uint64),
        ("first", ctypes.c_uint64),
        ("last", ctypes.c_uint64),
        ("error", ctypes.c_uint64),
        ("halve", ctypes.c_uint64),
        ("share", ctypes.c_uint64),
        ("seed", ctypes.c_uint64),
        ("counted", ctypes.c_uint64),
        ("failed", ctypes.c_uint64),
        ("of_operation", ctypes.c_uint64 * len(OPERATIONS)),
        ("notes", (ctypes.c_char * _NOTE) * _NOTES),
    )


@dataclass(frozen=True)
class Fault:
    """How calls fail from some number on.

    Attributes:
        name: As a test shows it.
        error: Their `errno`.
        calls: How many in a row fail.
        halve: Whether a write stores half of its bytes and succeeds, as it may, instead.
    """

    name: str
    error: int
    calls: int = 1
    halve: bool = False


FAULTS = (
    Fault("one-EIO", errno.EIO),
    Fault("one-ENOSPC", errno.ENOSPC),
    Fault("EIO-from-then-on", errno.EIO, _EVER),
    Fault("ENOSPC-from-then-on", errno.ENOSPC, _EVER),
    Fault("one-short-write", 0, halve=True),
)


def reason_to_skip() -> str | None:
    """Return why no fault can be injected here, `None` if they can."""
    if _compiler() is None:
        return "no C compiler (cc): no disk fault is injected"
    return None


def _compiler() -> str | None:
    return shutil.which(os.environ.get("CC", "cc"))


def built_library(folder: Path) -> Path:
    """Build the library to preload in a folder and return it."""
    compiler = _compiler()
    assert compiler is not None, reason_to_skip()
    library = folder / "faults.so"
    options = ("-shared", "-fPIC", "-O1", "-Wall", "-Werror")
    subprocess.run([compiler, *options, "-o", library, _SOURCE, "-ldl"], check=True, timeout=60)
    return library


class Faults:
    """Decides which calls of a service fail, from this process.

    Args:
        library: What `built_library` returned.
        folder: Where the file is that is shared with the service; not under `under`.
        under: Files of this folder are meant.
    """

    def __init__(self, library: Path, folder: Path, under: Path) -> None:
        path = folder / "faults"
        path.write_bytes(bytes(ctypes.sizeof(_Control)))
        with path.open("r+b") as file:
            self._mapped = mmap.mmap(file.fileno(), 0)
        self._control = _Control.from_buffer(self._mapped)
        self._struck_s: float | None = None  # when a failure was first seen
        self.environment = {
            "LD_PRELOAD": str(library),
            "TENSORMAP_FAULTS": str(path),
            "TENSORMAP_FAULTS_UNDER": str(under.resolve()),
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        del self._control
        self._mapped.close()

    @property
    def failed(self) -> int:
        """How many calls failed since the last were armed."""
        return int(self._control.failed)

    @property
    def counted(self) -> dict[str, int]:
        """How many calls of each operation there were since the last were armed."""
        return dict(zip(OPERATIONS, map(int, self._control.of_operation), strict=True))

    def called(self, number: int) -> str:
        """Return what call `number`, from 1, was: its operation and its file."""
        if not 0 < number <= _NOTES:
            return f"call {number}"
        operation, _, path = self._control.notes[number - 1].value.decode().partition(" ")
        return f"call {number}: {OPERATIONS[int(operation)]} {path}" if path else f"call {number}"

    @contextmanager
    def failing(self, fault: Fault, first: int) -> Iterator[None]:
        """Let calls fail from call `first` of the block on, counted from 1."""
        with self._armed(first, first + fault.calls - 1, fault):
            yield

    @contextmanager
    def failing_often(self, fault: Fault, share: float, seed: int) -> Iterator[None]:
        """Let a share of the calls of a block fail, as a disk does that is about to die."""
        with self._armed(1, _EVER, fault, share, seed):
            yield

    def lift(self) -> None:
        """Let no more calls fail before the block ends: the disk is well again.

        That is so only some seconds after the first has failed, however long a build takes before.
        """
        if not self.failed:
            return
        if self._struck_s is None:
            self._struck_s = time.monotonic()
        if time.monotonic() > self._struck_s + _LIFT_S:
            self._control.armed = 0

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count the calls of a block; none fails."""
        with self._armed(_EVER, _EVER, FAULTS[0]):
            yield

    @contextmanager
    def _armed(
        self, first: int, last: int, fault: Fault, share: float = 1.0, seed: int = 0
    ) -> Iterator[None]:
        control = self._control
        control.armed = 0
        self._struck_s = None
        control.counted = control.failed = 0
        for operation in range(len(OPERATIONS)):
            control.of_operation[operation] = 0
        ctypes.memset(ctypes.addressof(control.notes), 0, ctypes.sizeof(control.notes))
        control.first, control.last = first, min(last, _EVER)
        control.error, control.halve = fault.error, int(fault.halve)
        control.share, control.seed = int(share * 2**32), seed
        control.armed = 1
        try:
            yield
        finally:
            control.armed = 0
