"""The service listens on its configured address, and no other (HSDS used all of them)."""

import re
import socket
import sys
from pathlib import Path

import pytest

from tests.support.process import serving

LISTENING = "0A"


def listened_on(pid):
    """Return the addresses on which a process takes TCP connections."""
    sockets = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(descriptor.readlink())
        except FileNotFoundError:
            continue  # it was closed meanwhile
        if match := re.fullmatch(r"socket:\[(\d+)\]", target):
            sockets.add(match[1])
    for table, size in (("tcp", 4), ("tcp6", 16)):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == LISTENING and fields[9] in sockets:
                yield address_of(fields[1].partition(":")[0], size)


def address_of(text, size):
    # Words of four bytes, each in the order of this machine.
    words = [bytes.fromhex(text[i : i + 8]) for i in range(0, 2 * size, 8)]
    if sys.byteorder == "little":
        words = [word[::-1] for word in words]
    return socket.inet_ntop(socket.AF_INET if size == 4 else socket.AF_INET6, b"".join(words))


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads Linux' own tables")
@pytest.mark.parametrize("chosen", [None, "127.0.0.2"])
def test_the_service_listens_on_its_address_and_no_other(tmp_path, chosen):
    options = [] if chosen is None else ["--host", chosen]
    with serving(tmp_path / "data", tmp_path / "log", *options) as server:
        assert list(listened_on(str(server.pid))) == [chosen or "127.0.0.1"]
