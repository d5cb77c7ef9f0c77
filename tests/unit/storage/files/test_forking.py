"""Processes that are forked from a clean one."""

import os
import subprocess
import sys

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


def test_a_folder_for_temporary_files_of_any_length_of_name_will_do(tmp_path):
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    program = tmp_path / "program.py"
    program.write_text(_PROGRAM)
    here = {"TMPDIR": str(folder), "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run(
        [sys.executable, program], env=os.environ | here, capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (0, "forked\n"), ended.stderr
