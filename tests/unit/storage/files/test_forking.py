"""Processes that are forked from a clean one."""

import errno
import os
import subprocess
import sys
import tempfile
from multiprocessing.context import ForkServerProcess

import pytest

from storage.errors import StorageUnavailable
from storage.files import forking

_PROGRAM = """
import tempfile
from storage.files.forking import forkserver

if __name__ == "__main__":
    chosen = tempfile.gettempdir()
    child = forkserver().Process(target=print, args=("forked",))
    child.start()
    child.join()
    assert tempfile.gettempdir() == chosen
    raise SystemExit(child.exitcode)
"""


_INTERRUPTED = """
import os
import signal
import threading
from multiprocessing import forkserver as of_all
from storage.files.forking import forkserver, start_forked

if __name__ == "__main__":
    start_forked(lambda: forkserver().Process(target=print, args=("first",))).join()
    server = of_all._forkserver._forkserver_pid
    os.kill(server, signal.SIGSTOP)  # it does not answer the request that follows
    killing = threading.Timer(0.3, os.kill, (server, signal.SIGKILL))
    killing.start()
    child = start_forked(lambda: forkserver().Process(target=print, args=("second",)))
    child.join()
    raise SystemExit(child.exitcode)
"""


def run(tmp_path, text, **environment):
    program = tmp_path / "program.py"
    program.write_text(text)
    return subprocess.run(
        [sys.executable, program],
        env=os.environ | environment | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_a_folder_for_temporary_files_of_any_length_of_name_will_do(tmp_path):
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    ended = run(tmp_path, _PROGRAM, TMPDIR=str(folder))
    assert (ended.returncode, ended.stdout) == (0, "forked\n"), ended.stderr


def test_where_no_folder_for_temporary_files_can_be_written_that_is_named(monkeypatch):
    def none():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    with pytest.raises(StorageUnavailable, match=r"found in \['/tmp'\].*or set TMPDIR"):
        forking.forkserver()


def test_a_process_is_started_although_the_one_that_forks_is_killed(tmp_path):
    ended = run(tmp_path, _INTERRUPTED)
    assert (ended.returncode, ended.stdout) == (0, "first\nsecond\n"), ended.stderr


class Failing(ForkServerProcess):
    def __init__(self, errors):
        super().__init__(name="failing")
        self._errors = errors

    def start(self):
        if self._errors:
            raise self._errors.pop(0)


def test_a_process_is_started_again_twice_and_then_said_not_to_start(monkeypatch):
    monkeypatch.setattr(forking, "_PAUSES_S", (0.0, 0.0))
    errors = [EOFError(), ConnectionRefusedError()]
    assert forking.start_forked(lambda: Failing(errors)).name == "failing"
    assert errors == []
    errors = [EOFError(), BrokenPipeError(), EOFError("unexpected EOF")]
    with pytest.raises(OSError, match=r"failing cannot be started.*unexpected EOF"):
        forking.start_forked(lambda: Failing(errors))
