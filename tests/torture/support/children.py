"""Children that do dangerous things one after the other, watched so that none can hang."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.torture.support.sizes import SEED, TREE

_ROOT = Path(__file__).parents[3]
_TICKS = os.sysconf("SC_CLK_TCK")
_LOOK_S = 0.25
_LONGEST_CPU_S = 2.0  # of one thing: then it has hung
_LONGEST_S = 300.0  # on a machine that is busy with other things
_START_S = 300.0


@dataclass(frozen=True)
class Fared:
    """How one thing ended.

    Attributes:
        number: Which one.
        how: The child's report, a result or the name of an error; `hung`, or `died of signal n`.
        cpu_s: Processor time that it took.
        memory_bytes: The most that the child held meanwhile.
    """

    number: int
    how: str
    cpu_s: float
    memory_bytes: int


def fared(module: str, words: list[str], first: int, last: int) -> Iterator[Fared]:
    """Yield how each number fared in `python -m module words first last`.

    The readers are those of the tree that is attacked. A child that hangs or dies is followed by
    another one, which continues after that number.
    """
    while first < last:
        for one in _of_one_child(module, words, first, last):
            yield one
            first = one.number + 1


def least_cpu_s(module: str, words: list[str], one: Fared, enough_s: float) -> float:
    """Return the processor time of one thing: what else a machine does only ever adds to it.

    One that took more than `enough_s` is done again, at most twice, and the least time counts.
    """
    least_s = one.cpu_s
    for _ in range(2):
        if least_s <= enough_s:
            break
        least_s = min(
            [least_s, *(o.cpu_s for o in fared(module, words, one.number, one.number + 1))]
        )
    return least_s


def _of_one_child(module: str, words: list[str], first: int, last: int) -> Iterator[Fared]:
    environment = {
        **os.environ,
        "PYTHONPATH": f"{TREE}{os.pathsep}{_ROOT}",
        "TENSORMAP_TORTURE_SEED": str(SEED),
        "PYTHONFAULTHANDLER": "1",
    }
    command = [sys.executable, "-m", module, *words, str(first), str(last)]
    with subprocess.Popen(
        command, cwd="/", env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        try:
            yield from _watched(child, first, last)
        finally:
            child.kill()


def _watched(child: subprocess.Popen[bytes], first: int, last: int) -> Iterator[Fared]:
    assert child.stdout is not None
    assert child.stderr is not None
    number, began_cpu_s, waited_s = -1, 0.0, 0.0
    rest = b""
    while number < last - 1 or began_cpu_s >= 0:
        if not select.select([child.stdout], [], [], _LOOK_S)[0]:
            waited_s += _LOOK_S
            used_s = _cpu_s(child.pid) - began_cpu_s
            limit_s = _START_S if number < 0 else _LONGEST_S
            if number >= 0 and began_cpu_s >= 0 and (used_s > _LONGEST_CPU_S or waited_s > limit_s):
                child.kill()
                yield Fared(number, "hung", used_s, 0)
                return
            assert waited_s < limit_s, "the child does not start"
            continue
        waited_s = 0.0
        came = os.read(child.stdout.fileno(), 65536)
        if not came:
            status = child.wait(30)
            errors = child.stderr.read().decode(errors="replace")
            assert number >= 0, errors[-3000:]
            how = (
                f"died of {signal.Signals(-status).name}" if status < 0 else f"ended with {status}"
            )
            yield Fared(number, f"{how}: {errors[-600:]}", 0.0, 0)
            return
        *lines, rest = (rest + came).split(b"\n")
        for line in lines:
            word, numbered, *facts = line.decode().split(" ", 4)
            number = int(numbered)
            if word == "begin":
                began_cpu_s = _cpu_s(child.pid)
            else:
                began_cpu_s = -1.0
                cpu_s, kilobytes, how = facts
                yield Fared(number, how, float(cpu_s), int(kilobytes) * 1024)


def _cpu_s(pid: int) -> float:
    try:
        facts = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return (int(facts[11]) + int(facts[12])) / _TICKS
