"""The service listens on its configured address, and no other (HSDS used all of them)."""

import errno
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.support.commands import ROOT, called, tensormap
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


def test_an_address_that_cannot_be_listened_on_is_one_line(tmp_path):
    data = ("--data", tmp_path / "data")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        shown = tensormap("serve", *data, "--port", str(port), status=1)
        assert own_lines(shown) == [
            f"tensormap: cannot listen on 127.0.0.1:{port}: Address already in use"
        ]
    for host in ("0.0.0.0.0", "a" * 300):
        shown = called("serve", *data, "--port", "0", "--host", host, status=1)
        [line] = own_lines(shown)
        assert line.startswith(f"tensormap: cannot listen on {host}:0: ")
        assert "Unknown error" not in line
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    ("setting", "variables", "event"),
    [
        ("TENSORMAP_LOG_FORMAT", {"TENSORMAP_HOST": "0.0.0.0.0"}, "cannot listen on 0.0.0.0.0:0: "),
        (
            "TENSORMAP_LOG_FORMAT",
            {"TENSORMAP_LOG_LEVEL": "LOUD"},
            "TENSORMAP_LOG_LEVEL: should be 'DEBUG', ",
        ),
        ("TENSORMAP_LOG_FORMAT", {"TENSORMAP_DATA_DIR": "data/notes/new"}, "data/notes: "),
        ("Tensormap_Log_Format", {}, "data is no data directory, "),
    ],
)
def test_an_error_of_the_start_is_an_object_where_the_lines_of_the_log_are(
    tmp_path, monkeypatch, setting, variables, event
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "data/notes").touch()
    options = {setting: "json", **variables}
    *warnings, last = called("serve", "--port", "0", status=1, **options).splitlines()
    assert {json.loads(line)["level"] for line in warnings} <= {"warning"}  # of other variables
    facts = json.loads(last)
    assert event in facts["event"]
    assert (facts["level"], facts["logger"]) == ("error", "tensormap")
    shown = called("verify", status=1, **options)  # it writes no log
    assert own_lines(shown)[0].startswith("tensormap: ")


def test_an_address_that_is_taken_is_said_before_the_service_is_imported(tmp_path):
    begun = "import sys; sys.argv[1:] = {}; from app.cli import main\ntry: main()\n"
    ended = "except SystemExit: print('app.main' in sys.modules)"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        words = ["serve", "--data", str(tmp_path), "--port", str(taken.getsockname()[1])]
        program = begun.format(words) + ended
        command = [sys.executable, "-c", program]
        shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert "Address already in use" in shown.stderr
    assert shown.stdout == "False\n"


def test_an_address_of_a_protocol_that_the_system_lacks_is_one_line(tmp_path, monkeypatch):
    class Lacking(socket.socket):
        def __init__(self, *_, **__):
            raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))

    monkeypatch.setattr(socket, "socket", Lacking)  # as with ipv6.disable=1
    shown = called("serve", "--data", tmp_path, "--port", "0", "--host", "::1", status=1)
    assert own_lines(shown) == [
        "tensormap: cannot listen on ::1:0: Address family not supported by protocol"
    ]


def test_a_system_without_a_folder_for_temporary_files_is_one_line(tmp_path, monkeypatch):
    def none():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "gettempdir", none)  # as where all but the data is read-only
    shown = called("serve", "--data", tmp_path / "data", "--port", "0", status=1)
    [line] = own_lines(shown)
    assert line.startswith("tensormap: No usable temporary directory found in ['/tmp']: ")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    "command", [["serve"], ["verify"], ["audit", "verify"], ["recycle-bin", "list"]]
)
def test_a_wrong_setting_is_one_line_with_its_value_unless_that_is_a_key(command):
    shown = called(*command, status=1, TENSORMAP_ADMIN_KEY="short", TENSORMAP_PORT="-1")
    assert shown == (
        "tensormap: TENSORMAP_PORT: should be greater than or equal to 0, got '-1';"
        " TENSORMAP_ADMIN_KEY: wanted at least 16 characters, got 5\n"
    )


def own_lines(shown):
    """Return what a command says but for its log, which names settings of the tests' own."""
    return [line for line in shown.splitlines() if "is no setting of TensorMap" not in line]
