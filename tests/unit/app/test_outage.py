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
    assert [record.exc_info is not None for record in caplog.records] == [True, True, False]
