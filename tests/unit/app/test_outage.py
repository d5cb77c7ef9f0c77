"""What is tried again and again is logged once an outage."""

import logging

import pytest

from app.outage import Outage
from storage.errors import StorageUnavailable


def test_an_outage_is_logged_once_of_each_cause_and_at_its_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    outage = Outage(logging.getLogger("tensormap.jobs"), "no job can be run now")
    outage.over()
    for cause in ("the database restarts", "the database restarts", "the disk is full"):
        outage.failed(StorageUnavailable(cause))
    outage.over()
    outage.over()
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("ERROR", "no job can be run now: the database restarts"),
        ("ERROR", "no job can be run now: the disk is full"),
        ("INFO", "this is over: no job can be run now"),
    ]


def test_an_outage_of_the_storage_is_one_line_with_its_cause_and_a_fault_has_its_trace(
    caplog: pytest.LogCaptureFixture,
) -> None:
    outage = Outage(logging.getLogger("tensormap.jobs"), "no job can be run now")
    failure = StorageUnavailable("the disk fails")
    failure.__cause__ = OSError("/data: Input/output error")
    outage.failed(failure)
    outage.failed(ZeroDivisionError("a fault of ours"))
    assert [(record.getMessage(), bool(record.exc_info)) for record in caplog.records] == [
        ("no job can be run now: the disk fails (/data: Input/output error)", False),
        ("no job can be run now: a fault of ours", True),
    ]
