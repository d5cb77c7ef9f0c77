"""All that one key can hold open at once, from a process of its own, until its input ends.

`python -m tests.torture.support.starving PORT`; what is to be sent comes as JSON on standard input,
a line; it says `ready` once all is under way, and in the end what was answered.
"""

import asyncio
import json
import sys
from typing import Any

from tests.torture.support.crowds import idle_connections, open_websockets
from tests.torture.support.load import Load, Request, as_json

__all__: list[str] = []

_LENGTH = 10**9  # of an upload that never ends


async def _starve(port: int, wanted: dict[str, Any]) -> None:
    of_map, headers = wanted["path"], wanted["headers"]
    tar = Request(
        "POST", f"{of_map}/drives/slow/scans", {**headers, "Content-Type": "application/x-tar"}
    )
    as_text = {**headers, "Content-Type": "application/json"}
    closures = Request("POST", f"{of_map}/loop-closures", as_text, as_json(wanted["closures"]))
    keys = b",".join(b'"%07d":1' % number for number in range(wanted["json_bytes"] // 12))
    unknown = Request("PATCH", of_map, as_text, b"{" + keys + b"}")
    stream = f"{of_map}/tracks/{wanted['track']}/stream"
    async with Load(port) as load, idle_connections(port, wanted["idle"]) as idle:
        load.trickle(tar, wanted["uploads"], length=_LENGTH)
        load.repeat(closures, wanted["closing"])
        load.repeat(unknown, wanted["bodies"])
        async with open_websockets(port, stream, headers, wanted["websockets"]) as sockets:
            print("ready", flush=True)
            await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
            told = f"idle {len(idle)} ({idle.closed} closed), websockets {dict(sockets.answers)}"
            print(f"{told}, requests {load.answers.statuses}", flush=True)


if __name__ == "__main__":
    asyncio.run(_starve(int(sys.argv[1]), json.loads(sys.stdin.readline())))
