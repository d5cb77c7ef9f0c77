"""An upload sends what is missing, in groups and in bounded memory."""

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tensormap_client import NothingUsable, OtherDrive, ScanBody, UnusableScan
from tensormap_client._sync.drive_requests import DriveRequests
from tensormap_client._sync.transport import Transport
from tensormap_client._sync.upload import upload_drive
from tensormap_client.problems import ScopeMissing
from tensormap_client.progress import NO_PROGRESS
from tensormap_client.uploaded import Put, StoredScans, Unusable

from storage.index_ranges import index_ranges
from tests.support.scan_files import npy

NPY = "application/vnd.tensormap.npy"


class Recorded:
    """A source of scans that are made when they are sent; some of them have no returns."""

    name, beside = "recorded", ()

    def __init__(
        self, scans: int, empty: Sequence[int] = (), size_bytes: int = 0, *, parses: bool = True
    ) -> None:
        self._scans, self._empty, self._size_bytes = scans, empty, size_bytes
        self._parses = parses

    def __len__(self) -> int:
        return self._scans

    def scan_body(self, index: int) -> ScanBody:
        if index in self._empty:
            raise UnusableScan("it has 0 returns")
        points_m = np.full((1, 3), index + 1.0, np.float32)
        body = bytes(self._size_bytes) or npy(points_m)
        returns_m = (lambda: points_m) if self._parses else None
        return ScanBody(index, body, NPY, returns_m=returns_m)


class Service(DriveRequests):
    """A service that remembers the index of each scan it received."""

    def __init__(self, *stored: tuple[int, int], closed: bool = False) -> None:
        super().__init__(
            Transport("http://maps.example", timeout_s=1.0, patience_s=1.0), "campus", "monday"
        )
        self.closed = closed
        self.kept = {index for first, last in stored for index in range(first, last + 1)}
        self.bodies: dict[int, bytes] = {}
        self.groups: list[list[int]] = []
        self.other: set[int] = set()
        self.present: set[int] = set()
        self.unusable: dict[int, str] = {}
        self.may_read = True

    def stored(self):
        ranges = tuple((run.first, run.last) for run in index_ranges(sorted(self.kept)))
        return StoredScans(ranges)

    def returns_m(self, index):
        if not self.may_read:
            raise ScopeMissing("403", 403, "scope-missing", "")
        return np.full((1, 3), 0.5 if index in self.other else index + 1.0, np.float32)

    def put_scan(self, scan):
        return self.put_scans([scan])

    def put_scans(self, scans):
        self.groups.append([scan.index for scan in scans])
        found = []
        for scan in scans:
            if scan.index in self.other:
                found.append(Unusable(str(scan.index), "scan-conflict", "other returns"))
            elif scan.index in self.unusable:
                found.append(Unusable(str(scan.index), self.unusable[scan.index], "of no use"))
            elif self.closed and scan.index not in self.kept:
                found.append(Unusable(str(scan.index), "drive-closed", "the drive is closed"))
            else:
                self.kept.add(scan.index)
        present = len(self.present.intersection(scan.index for scan in scans))
        return Put(present, tuple(found))

    def received(self) -> list[int]:
        return sorted(index for group in self.groups for index in group)


def test_what_is_stored_is_not_sent_again() -> None:
    service = Service((0, 3), (6, 6))
    done = upload_drive(service, Recorded(10), NO_PROGRESS)
    assert service.received() == [4, 5, 7, 8, 9]
    assert (done.before, done.stored, done.skipped_scans) == (5, 5, 0)


def test_scans_that_another_upload_stores_meanwhile_count_as_there_already() -> None:
    service = Service((0, 3))
    service.present = {5, 8}
    done = upload_drive(service, Recorded(10), NO_PROGRESS)
    assert service.received() == [4, 5, 6, 7, 8, 9]
    assert (done.before, done.stored, done.skipped_scans) == (6, 4, 0)


def test_at_most_one_percent_of_a_drive_is_on_its_way_in_one_group() -> None:
    service = Service()
    upload_drive(service, Recorded(2000), NO_PROGRESS)
    assert max(len(group) for group in service.groups) == 5  # of four groups
    assert service.received() == list(range(2000))


def test_large_scans_are_sent_one_by_one() -> None:
    service = Service()
    upload_drive(service, Recorded(800, size_bytes=2**19 + 1), NO_PROGRESS)
    assert {len(group) for group in service.groups} == {1}


def test_unusable_scans_are_skipped_with_their_reason() -> None:
    service = Service()
    service.unusable = {7: "too-few-returns"}
    done = upload_drive(service, Recorded(10, empty=[2]), NO_PROGRESS)
    assert (done.stored, done.skipped_scans) == (8, 2)
    assert [(one.index, one.reason) for one in done.skipped] == [
        (2, "it has 0 returns"),
        (7, "of no use"),
    ]


def test_a_drive_without_a_usable_scan_is_an_error_that_says_why() -> None:
    with pytest.raises(NothingUsable, match=r"none of the 3 scans .* scan 0: it has 0 returns"):
        upload_drive(Service(), Recorded(3, empty=range(3)), NO_PROGRESS)


def test_a_drive_with_other_returns_is_not_continued() -> None:
    service = Service((0, 4))
    service.other = {4}
    with pytest.raises(OtherDrive, match="scan 4 of drive 'monday' has other returns"):
        upload_drive(service, Recorded(10), NO_PROGRESS)
    assert not service.groups


def test_a_stored_scan_that_cannot_be_read_here_is_not_said_to_be_another_drives() -> None:
    class OfAnotherFormat(Recorded):
        def scan_body(self, index: int) -> ScanBody:
            return replace(super().scan_body(index), returns_m=self._refuse)

        def _refuse(self) -> NDArray[np.float32]:
            raise UnusableScan("it is no PCD file")

    with pytest.raises(UnusableScan, match=r"^scan 0 of drive 'monday' .*: it is no PCD file$"):
        upload_drive(Service((0, 4)), OfAnotherFormat(10), NO_PROGRESS)


def test_of_a_key_that_may_only_write_stored_scans_are_sent_for_comparison() -> None:
    service = Service((0, 4))
    service.may_read = False
    upload_drive(service, Recorded(6), NO_PROGRESS)
    assert service.groups == [[0], [2], [4], [5]]
    service.other = {5}
    with pytest.raises(OtherDrive, match="other returns: upload it as another drive"):
        upload_drive(service, Recorded(6), NO_PROGRESS)


def test_a_source_that_does_not_parse_has_stored_scans_compared_by_the_service() -> None:
    service = Service((0, 4))
    upload_drive(service, Recorded(6, parses=False), NO_PROGRESS)
    assert service.groups == [[0], [2], [4], [5]]
    service.other = {5}
    with pytest.raises(OtherDrive, match="other returns: upload it as another drive"):
        upload_drive(service, Recorded(6, parses=False), NO_PROGRESS)


@pytest.mark.parametrize(
    ("stored", "closed", "message"),
    [
        ([(0, 10)], False, "has a scan 10, recorded has 10"),
        ([(0, 4)], True, "is closed: upload it"),
    ],
)
def test_a_drive_that_cannot_take_the_scans_is_an_error(stored, closed, message) -> None:
    with pytest.raises(OtherDrive, match=message):
        upload_drive(Service(*stored, closed=closed), Recorded(10), NO_PROGRESS)


def test_the_first_the_last_and_the_scan_half_way_of_those_stored_are_compared() -> None:
    assert StoredScans().samples == ()
    assert StoredScans(((4, 4),)).samples == (4,)
    assert StoredScans(((0, 99),)).samples == (0, 50, 99)
    assert StoredScans(((0, 9), (20, 29), (40, 80))).samples == (0, 50, 80)


def test_a_conflict_ends_an_upload() -> None:
    service = Service()
    service.other = {3}
    with pytest.raises(OtherDrive, match="other returns"):
        upload_drive(service, Recorded(9), NO_PROGRESS)


def test_a_scan_more_takes_no_more_memory() -> None:
    def peak_bytes(scans: int) -> int:
        class Forgetful(Service):
            def put_scans(self, scans):
                self.kept.update(scan.index for scan in scans)
                return Put()

        tracemalloc.start()
        try:
            upload_drive(Forgetful(), Recorded(scans, size_bytes=10_000), NO_PROGRESS)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    assert peak_bytes(20_000) < 20 * 2**20  # of 200 MB


def test_a_source_without_a_scan_is_named():
    with pytest.raises(NothingUsable, match="recorded has no scan"):
        upload_drive(Service(), Recorded(0), NO_PROGRESS)
