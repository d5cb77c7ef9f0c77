from dataclasses import replace
from math import nan

from storage.catalog.records import ScanRecord

SCAN = ScanRecord(3, "chunk.h5", 0, "d" * 64, 100, 2, float("nan"), None)


def test_records_of_scans_without_a_time_are_equal_if_all_else_is():
    read_again = replace(SCAN, timestamp_s=float("nan"))
    assert read_again == SCAN
    assert len({SCAN, read_again}) == 1
    assert replace(SCAN, row=1) != SCAN


def test_a_time_is_compared():
    timed = replace(SCAN, timestamp_s=1.0)
    assert timed == replace(SCAN, timestamp_s=1.0)
    assert timed not in (SCAN, replace(SCAN, timestamp_s=2.0))
    assert replace(timed, timestamp_s=nan) == SCAN
