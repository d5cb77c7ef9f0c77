"""What the process that forks jobs has loaded."""

import subprocess
import sys

from tests.support.commands import ROOT

PROGRAM = """
import gc, sys
import app.jobs.preloaded
print(gc.isenabled(), gc.get_freeze_count() > 100_000, gc.get_stats()[2]["collections"])
needed = {"app.jobs.worker", "h5py", "scipy.optimize", "sqlalchemy.dialects.sqlite"}
print(needed <= sys.modules.keys())
"""


def test_what_builds_need_is_loaded_and_left_out_of_garbage_collections() -> None:
    shown = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert shown.split() == ["True", "True", "0", "True"]
