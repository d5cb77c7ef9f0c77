"""An upload sends what is missing, in groups and in bounded memory."""

import math
import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest

from app.cli.console import LineProgress
from app.upload_client.drive_requests import DriveRequests, StoredScans, Unusable
from app.upload_client.errors import NothingUsable, OtherDrive, Rejected
from app.upload_client.sources import ScanBody
from app.upload_client.transport import Transport
from app.upload_client.upload import upload_drive
from core.errors import TooFewReturns
from tests.support.scan_files import npy

NPY = "application/vnd.tensormap.npy"


class Recorded:
    """A source of scans that are made when they are sent; some of them have no returns."""

    name = "recorded"

    def __init__(self, scans: int, empty: Sequence[int] = (), size_bytes: int = 0) -> None:
        self._scans, self._empty, self._size_bytes = scans, empty, size_bytes

    def __len__(self) -> int:
        return self._scans

    def scan_body(self, index: int) -> ScanBody:
        if index in self._empty:
            raise TooFewReturns("it has 0 returns")
        body = bytes(self._size_bytes) or npy(np.full((1, 3), index + 1.0, np.float32))
        return ScanBody(index, body, NPY, math.nan, None)


class Service(DriveRequests):
    """A service that remembers the index of each scan it received."""

    def __init__(self, *stored: tuple[int, int], closed: bool = False) -> None:
        super().__init__(Transport("http://maps.example"), "campus", "monday")
        self.before = StoredScans(stored, closed)
        self.bodies: dict[int, bytes] = {}
        self.groups: list[list[int]] = []
        self.other: set[int] = set()
        self.unusable: dict[int, str] = {}
        self.may_read = True

    def stored(self):
        return self.before

    def returns_m(self, index):
        if not self.may_read:
            raise Rejected("403", 403, "scope-missing", "")
        return np.full((1, 3), 0.5 if index in self.other else index + 1.0, np.float32)

    def put_scan(self, scan):
        return self.put_scans([scan])

    def put_scans(self, scans):
        self.groups.append([scan.index for scan in scans])
        found = []
        for scan in scans:
            if scan.index in self.other:
                found.append(Unusable(scan.index, "scan-conflict", "other returns"))
            elif scan.index in self.unusable:
                found.append(Unusable(scan.index, self.unusable[scan.index], "of no use"))
        return found

    def received(self) -> list[int]:
        return sorted(index for group in self.groups for index in group)


def test_what_is_stored_is_not_sent_again() -> None:
    service = Service((0, 3), (6, 6))
    done = upload_drive(service, Recorded(10), LineProgress())
    assert service.received() == [4, 5, 7, 8, 9]
    assert (done.before, done.stored, done.skipped_scans) == (5, 5, 0)


def test_at_most_one_percent_of_a_drive_is_on_its_way_in_one_group() -> None:
    service = Service()
    upload_drive(service, Recorded(2000), LineProgress())
    assert max(len(group) for group in service.groups) == 5  # of four groups
    assert service.received() == list(range(2000))


def test_large_scans_are_sent_one_by_one() -> None:
    service = Service()
    upload_drive(service, Recorded(800, size_bytes=2**19 + 1), LineProgress())
    assert {len(group) for group in service.groups} == {1}


def test_unusable_scans_are_skipped_with_their_reason() -> None:
    service = Service()
    service.unusable = {7: "too-few-returns"}
    done = upload_drive(service, Recorded(10, empty=[2]), LineProgress())
    assert (done.stored, done.skipped_scans) == (8, 2)
    assert [(one.index, one.reason) for one in done.skipped] == [
        (2, "it has 0 returns"),
        (7, "of no use"),
    ]


def test_a_drive_without_a_usable_scan_is_an_error_that_says_why() -> None:
    with pytest.raises(NothingUsable, match=r"none of the 3 scans .* scan 0: it has 0 returns"):
        upload_drive(Service(), Recorded(3, empty=range(3)), LineProgress())


def test_a_drive_with_other_returns_is_not_continued() -> None:
    service = Service((0, 4))
    service.other = {4}
    with pytest.raises(OtherDrive, match="scan 4 of drive 'monday' has other returns"):
        upload_drive(service, Recorded(10), LineProgress())
    assert not service.groups


def test_of_a_key_that_may_only_write_one_scan_is_sent_for_comparison() -> None:
    service = Service((0, 4))
    service.may_read = False
    upload_drive(service, Recorded(6), LineProgress())
    assert service.groups == [[0], [5]]
    service.other = {0}
    with pytest.raises(OtherDrive, match="other returns: upload it as another drive"):
        upload_drive(service, Recorded(6), LineProgress())


@pytest.mark.parametrize(
    ("stored", "closed", "message"),
    [([(0, 10)], False, "has a scan 10, recorded has 10"), ([(0, 4)], True, "closed with 5 scans")],
)
def test_a_drive_that_cannot_take_the_scans_is_an_error(stored, closed, message) -> None:
    with pytest.raises(OtherDrive, match=message):
        upload_drive(Service(*stored, closed=closed), Recorded(10), LineProgress())


def test_a_conflict_ends_an_upload() -> None:
    service = Service()
    service.other = {3}
    with pytest.raises(OtherDrive, match="other returns"):
        upload_drive(service, Recorded(9), LineProgress())


def test_a_scan_more_takes_no_more_memory() -> None:
    def peak_bytes(scans: int) -> int:
        class Forgetful(Service):
            def put_scans(self, scans):
                return []

        tracemalloc.start()
        try:
            upload_drive(Forgetful(), Recorded(scans, size_bytes=10_000), LineProgress())
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    assert peak_bytes(20_000) < 20 * 2**20  # of 200 MB
