"""Damaged files of every kind: each is read, or refused by name, at once and in little memory."""

import pytest

from tests.torture.support.children import fared, least_cpu_s
from tests.torture.support.reading import SUBJECTS
from tests.torture.support.sizes import size

_FILES = size("flips", 500)
_SLOW = {"Backup": 10, "Catalog": 10}  # so many times fewer: each is a store of its own
_LONGEST_CPU_S = 1.0
_GROWN_BYTES = 200 * 2**20
_READING = "tests.torture.support.reading"


@pytest.mark.parametrize("subject", SUBJECTS)
def test_a_damaged_file_is_read_or_refused_by_name(subject, tmp_path):
    count = max(1, _FILES // _SLOW.get(subject, 1))
    wrong: list[str] = []
    least = 0
    words = [subject, str(tmp_path)]
    for one in fared(_READING, words, 0, count):
        least = least or one.memory_bytes
        grown = one.memory_bytes - least
        bad = one.how.startswith(("hung", "died", "ended", "unnamed"))
        cpu_s = least_cpu_s(_READING, words, one, _LONGEST_CPU_S)
        if bad or cpu_s > _LONGEST_CPU_S:
            wrong.append(f"file {one.number}: {one.how} in {cpu_s:.2f} s")
        if grown > _GROWN_BYTES:
            wrong.append(f"file {one.number}: it holds {grown / 2**20:.0f} MB more")
            least = one.memory_bytes
    assert not wrong, f"{len(wrong)} of {count}:\n" + "\n".join(wrong[:20])
