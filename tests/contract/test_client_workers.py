"""The promise of the client's workers, with threads and with asyncio."""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress

import pytest
from tensormap_client import io_async, io_sync

REQUEST_S = 0.5  # long beside the moment in which the third would begin


class Drive:
    """A drive that receives scans, and those that arrive after its deletion."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.stored: list[int] = []
        self.late: list[int] = []
        self.is_deleted = False

    def receive(self, index: int) -> None:
        (self.late if self.is_deleted else self.stored).append(index)


def with_threads(drive: Drive, error: type[Exception] | None) -> None:
    """Put three scans, two at a time; leave by an error while two are sent; delete the drive."""

    def put(index: int) -> None:
        drive.begun.append(index)
        time.sleep(REQUEST_S)  # a request on its way, which nothing can end
        drive.receive(index)

    with suppress(OSError), io_sync.Workers(2) as workers:
        for index in range(3):
            workers.start(put, index)
        while len(drive.begun) < 2:
            time.sleep(0.001)
        if error is not None:
            raise error
    drive.is_deleted = True
    time.sleep(2 * REQUEST_S)


def with_asyncio(drive: Drive, error: type[Exception] | None) -> None:
    """Do the same."""

    async def put(index: int) -> None:
        drive.begun.append(index)
        await asyncio.sleep(REQUEST_S)
        drive.receive(index)

    async def main() -> None:
        with suppress(OSError):
            async with io_async.AsyncWorkers(2) as workers:
                for index in range(3):
                    workers.start(put, index)
                while len(drive.begun) < 2:
                    await asyncio.sleep(0.001)
                if error is not None:
                    raise error
        drive.is_deleted = True
        await asyncio.sleep(2 * REQUEST_S)

    asyncio.run(main())


modes = pytest.mark.parametrize("upload", [with_threads, with_asyncio])
Upload = Callable[[Drive, type[Exception] | None], None]


@modes
def test_nothing_runs_on_after_a_block_that_an_error_ends(upload: Upload) -> None:
    drive = Drive()
    upload(drive, OSError)
    assert (drive.begun, drive.late) == ([0, 1], [])


@modes
def test_a_block_that_ends_without_an_error_waits_for_all_of_its_work(upload: Upload) -> None:
    drive = Drive()
    upload(drive, None)
    assert (sorted(drive.stored), drive.late) == ([0, 1, 2], [])
