"""Set-up of processes before they compute and serve."""

import gc
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from app.process import collect_seldom, loading, most_build_memory_bytes

ROOT = Path(__file__).parents[3]
ARRAYS, MEGABYTES = 40, 4
FEW_PAGES = ARRAYS * MEGABYTES * 2**20 // os.sysconf("SC_PAGE_SIZE") // 4
# One after the other, with something small that outlives each of them, as in a build.
PROGRAM = f"""
import resource

import numpy as np
{{}}
kept = []
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range({ARRAYS}):
    one, other = np.ones({MEGABYTES} * 2**17), np.ones({MEGABYTES} * 2**17)
    kept.append(np.ones(10))
    del one, other
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
KEEP = "from app.process import keep_freed_memory; keep_freed_memory()"

on_glibc = pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="this is for glibc's allocator"
)


def page_faults(before: str, **variables: str) -> int:
    """Count what the system clears for a program, in a process of its own."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))}
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(before)],
        cwd=ROOT,
        env={**kept, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(ended.stdout)


@on_glibc
def test_arrays_come_from_memory_that_earlier_ones_left() -> None:
    assert page_faults(KEEP) < FEW_PAGES


@on_glibc
def test_an_allocator_that_the_operator_set_up_is_left_as_it_is() -> None:
    assert page_faults(KEEP, MALLOC_TRIM_THRESHOLD_="1048576") > FEW_PAGES


def test_objects_from_before_the_start_are_left_out_of_garbage_collections() -> None:
    before = gc.get_threshold()
    loaded: list[list[int]] = [[]]
    try:
        collect_seldom()
        assert not any(found is loaded for found in gc.get_objects())
        later: list[list[int]] = [[]]
        assert any(found is later for found in gc.get_objects())
        assert gc.get_threshold() == (*before[:2], 50)
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


def test_what_a_block_loads_is_left_out_of_garbage_collections() -> None:
    try:
        with loading():
            loaded: list[list[int]] = [[]]
            assert not gc.isenabled()
        assert gc.isenabled()
        assert not any(found is loaded for found in gc.get_objects())
    finally:
        gc.unfreeze()


def test_garbage_that_is_not_collected_before_loading_is_not_after_it() -> None:
    gc.disable()
    try:
        with loading():
            loaded: list[list[int]] = [[]]
        assert not gc.isenabled()
        assert any(found is loaded for found in gc.get_objects())
    finally:
        gc.enable()


def test_blas_has_one_thread_also_in_a_library_that_is_loaded_later():
    program = """
from app.process import one_blas_thread
one_blas_thread()
import numpy, scipy.linalg, threadpoolctl
print({found["num_threads"] for found in threadpoolctl.threadpool_info()})
"""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.strip() == "{1}"


@pytest.mark.skipif(
    not Path("/proc/self/oom_score_adj").exists(), reason="this is for the kernel of Linux"
)
def test_a_process_that_ends_before_others_is_the_first_that_linux_would_end():
    program = """
from pathlib import Path
from app.process import end_before_others
end_before_others()
print(Path("/proc/self/oom_score_adj").read_text())
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "1000"


def test_builds_at_once_share_the_memory_that_one_alone_may_take():
    alone = most_build_memory_bytes(1)
    assert 2**30 <= alone <= os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert most_build_memory_bytes(2) == max(alone // 2, 2**30)
    assert most_build_memory_bytes(10**6) == 2**30
