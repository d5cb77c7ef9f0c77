"""Checks stored files in a process of its own, within limits of time and memory.

Damage may make a reader loop forever, end its process, or allocate all memory: none of that affects
the service or the command that checks.
"""

import os
import resource
import signal
import stat
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from multiprocessing.process import BaseProcess
from pathlib import Path

from storage.closing import Closing
from storage.files.forking import forkserver, start_forked
from storage.files.stored_file import Fault, StoredFile, fault_of

_PAGE_BYTES = resource.getpagesize()
_END_S = 5.0  # to wait for a killed process; one that waits for a dead disk remains
# Ends that content causes; others, such as a lack of memory, are not the file's fault.
_CRASHES = {-number for number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE)}
_GONE = "gone"


@dataclass(frozen=True)
class Limits:
    """Limits of the check of one file.

    Attributes:
        seconds: The seconds for any size; they include the start of a process.
        bytes_per_s: Least rate of reading, for additional seconds.
        memory_bytes: The memory for any size.
        memory_ratio: Additional bytes of memory for each byte of the file.
    """

    seconds: float = 30.0
    bytes_per_s: float = 4e6
    memory_bytes: int = 512 * 2**20
    memory_ratio: float = 4.0

    def seconds_for(self, size_bytes: int) -> float:
        """Return the time limit for a file of a size."""
        return self.seconds + size_bytes / self.bytes_per_s

    def memory_for(self, size_bytes: int) -> int:
        """Return the memory limit for a file of a size."""
        return self.memory_bytes + int(self.memory_ratio * size_bytes)


DEFAULT = Limits()


class Checker(Closing):
    """Checks files one by one in a child process; used by one thread, but for `interrupt`.

    A child that hangs or ends is replaced, and the current file is at fault.

    Args:
        limits: The limits for each file.
    """

    def __init__(self, limits: Limits = DEFAULT) -> None:
        self._limits = limits
        self._child: tuple[BaseProcess, Connection] | None = None

    def fault(self, path: Path, file: StoredFile) -> Fault | None:
        """Return the fault of a file, `None` if it is what was stored.

        Args:
            path: The file's path.
            file: What it should hold.

        Raises:
            FileNotFoundError: If it is gone.
        """
        try:
            found = path.stat()
        except FileNotFoundError:
            raise
        except OSError as error:
            return Fault(f"it cannot be read: {error}", certain=False)
        if not stat.S_ISREG(found.st_mode):  # opening another kind could block forever
            return Fault("it is no file")
        seconds = self._limits.seconds_for(found.st_size)
        answer = self._check(path, file, seconds, self._limits.memory_for(found.st_size))
        if answer == _GONE:
            raise FileNotFoundError(2, os.strerror(2), str(path))
        return answer if isinstance(answer, Fault) else None

    def _check(self, path: Path, file: StoredFile, seconds: float, memory: int) -> object:
        process, connection = self._child = self._child or _start()
        try:
            connection.send((path, file, seconds, memory))
            if connection.poll(seconds):
                return connection.recv()
        except (EOFError, OSError):
            process.join(_END_S)
            code = process.exitcode
            self.close()
            if code == -signal.SIGXCPU:
                return Fault(f"to read it took more than {seconds:.0f} s of CPU")
            ended = f"the process that read it ended with exit code {code}"
            return Fault(ended, certain=code in _CRASHES)
        self.close()
        return Fault(f"to read it took more than {seconds:.0f} s", certain=False)

    def interrupt(self) -> None:
        """End the check of another thread, which gets a fault that says nothing about the file."""
        child = self._child
        if child is not None:
            with suppress(ValueError):  # it was closed meanwhile
                child[0].kill()

    def close(self) -> None:
        """End the child."""
        if self._child is not None:
            process, connection = self._child
            self._child = None
            connection.close()
            process.kill()
            process.join(_END_S)
            with suppress(ValueError):  # it waits for a disk
                process.close()


def _start() -> tuple[BaseProcess, Connection]:
    context = forkserver()  # no fork of a process with threads
    pipe: list[Connection] = []

    def make() -> ForkServerProcess:
        pipe[:] = context.Pipe()
        return context.Process(target=_answer_all, args=(pipe[1],), name="checker", daemon=True)

    process = start_forked(make)
    ours, its = pipe
    its.close()
    return process, ours


def _answer_all(connection: Connection) -> None:
    """Check files until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends
    os.nice(10)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    while True:
        try:
            path, file, seconds, memory = connection.recv()
        except EOFError:
            return
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * _PAGE_BYTES
        _limit(resource.RLIMIT_AS, mapped + memory)
        # An endless loop ends also without a parent that would kill this process.
        used = resource.getrusage(resource.RUSAGE_SELF)
        _limit(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime + seconds) + 1)
        answer = _answer(path, file, memory)
        _limit(resource.RLIMIT_AS, resource.RLIM_INFINITY)
        connection.send(answer)


def _answer(path: Path, file: StoredFile, memory: int) -> Fault | str | None:
    try:
        return fault_of(path, file)
    except FileNotFoundError:
        return _GONE
    except MemoryError:
        return Fault(f"to read it took more than {memory // 2**20} MB of memory", certain=False)
    except OSError as error:
        return Fault(f"it cannot be read: {error}", certain=False)
    except Exception as error:  # noqa: BLE001 - any error that damage causes is the file's fault
        return Fault(f"it cannot be read: {type(error).__name__}: {error}")


def _limit(which: int, soft: int) -> None:
    _, hard = resource.getrlimit(which)
    if hard != resource.RLIM_INFINITY:
        soft = hard if soft == resource.RLIM_INFINITY else min(soft, hard)
    resource.setrlimit(which, (soft, hard))
