"""All that one key can hold open, from a process of its own, more with each step.

`python -m tests.torture.support.starving PORT MAP HEADERS`: a line of its standard input is a step,
as JSON; once that is under way it writes a line, with what was answered so far.
"""

import asyncio
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import AsyncExitStack, contextmanager
from typing import Any

from tests.support.commands import ROOT
from tests.torture.support.crowds import idle_connections, open_websockets
from tests.torture.support.load import Load, Request, as_json

_LENGTH = 10**9  # of an upload that never ends


class Greedy:
    """A process that holds open what a key can get."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def begin(self, step: str, **parameters: Any) -> None:
        """Have it hold open more, and do not wait for that."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([step, parameters]) + "\n")
        self._process.stdin.flush()

    def wait(self) -> str:
        """Return what it reports of its current step, once that is under way."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "what makes the load has failed"
        return line.strip()

    def hold(self, step: str, **parameters: Any) -> None:
        """Have it hold open more."""
        self.begin(step, **parameters)
        self.wait()


@contextmanager
def greedy(port: int, of_map: str, headers: Mapping[str, str]) -> Iterator[Greedy]:
    """Run that process until the block ends, and print what was answered.

    Args:
        port: Of the service.
        of_map: Path of the map.
        headers: With the key.
    """
    with subprocess.Popen(
        [sys.executable, "-m", __name__, str(port), of_map, json.dumps(dict(headers))],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            held = Greedy(process)
            yield held
            held.begin("count_requests")
            print(held.wait())
        finally:
            process.kill()


class _Steps:
    def __init__(
        self, port: int, of_map: str, headers: dict[str, str], load: Load, stack: AsyncExitStack
    ) -> None:
        self._port, self._map, self._headers = port, of_map, headers
        self._load, self._stack = load, stack
        self._json = {**headers, "Content-Type": "application/json"}
        self._answered: dict[str, Any] = {}

    async def idle(self, count: int) -> None:
        crowd = idle_connections(self._port, count)
        self._answered["idle connections"] = await self._stack.enter_async_context(crowd)

    async def uploads(self, count: int) -> None:
        headers = {**self._headers, "Content-Type": "application/x-tar"}
        tar = Request("POST", f"{self._map}/drives/slow/scans", headers)
        self._load.trickle(tar, count, length=_LENGTH)

    async def closures(self, count: int, proposals: list[dict[str, Any]]) -> None:
        body = as_json({"proposals": proposals})
        path = f"{self._map}/loop-closures"
        self._load.repeat(Request("POST", path, self._json, body), count)

    async def bodies(self, count: int, length: int) -> None:
        keys = b",".join(b'"%07d":1' % number for number in range(length // 12))
        self._load.repeat(Request("PATCH", self._map, self._json, b"{" + keys + b"}"), count)

    async def websockets(self, count: int, track: str) -> None:
        path = f"{self._map}/tracks/{track}/stream"
        crowd = open_websockets(self._port, path, self._headers, count)
        self._answered["WebSockets"] = await self._stack.enter_async_context(crowd)

    async def count_requests(self) -> None:
        self._answered["requests"] = Counter(self._load.answers.statuses)

    def __str__(self) -> str:
        return ", ".join(f"{name}: {answered}" for name, answered in self._answered.items())


async def _main(port: int, of_map: str, headers: dict[str, str]) -> None:
    loop = asyncio.get_running_loop()
    async with Load(port) as load, AsyncExitStack() as stack:
        steps = _Steps(port, of_map, headers, load, stack)
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            step, parameters = json.loads(line)
            await getattr(steps, step)(**parameters)
            print(steps, flush=True)


if __name__ == "__main__":
    asyncio.run(_main(int(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3])))
