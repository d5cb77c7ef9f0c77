"""The reception of an upload: its scans are stored while the rest of its body arrives."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from functools import partial
from typing import TypeVar

from fastapi import Request
from starlette.requests import ClientDisconnect

from app.drives.scan_upload import ScanUpload
from app.drives.schemas import UploadOut
from app.drives.tar_scans import is_index, member_time_s
from app.drives.tar_stream import listed
from app.http.bodies.incoming import Incoming
from app.http.bodies.spool import Spool
from app.http.client import Client
from app.http.pooled_route import run_heavy
from core.errors import TensorMapError
from storage.errors import StorageFailure

T = TypeVar("T")

_BATCH_BYTES = 4 * 2**20


async def store_as_received(
    request: Request, body: Incoming, upload: ScanUpload, lock: asyncio.Lock
) -> UploadOut:
    """Store the scans of a body, a few megabytes at a time, and return what became of them.

    Args:
        request: The request.
        body: Its body, of which nothing is received.
        upload: Stores the scans.
        lock: The drive's lock; held from the end of the body on if files are named by times:
            their indices are ranks among the drive's scans as it is then.

    Raises:
        TensorMapError: What receiving or storing raises; earlier scans are stored.
        ClientDisconnect: If the client left; earlier scans are stored.
    """

    async def in_pool(work: Callable[[], T]) -> T:
        return await run_heavy(request, work, begun=True)

    async with AsyncExitStack() as until_stored:
        # A decompressor takes megabytes: none waits for the rest of a slow body.
        batch = None if body.packed or body.has_digest else _BATCH_BYTES
        up_to, is_decided = batch, False
        spool = until_stored.enter_context(body.spool())
        while not body.ended:
            try:
                await body.fill(spool, up_to)
            except (TensorMapError, ClientDisconnect) as error:
                if not body.has_digest:
                    await in_pool(partial(_store_rest, upload, body, spool))
                if isinstance(error, StorageFailure):
                    raise upload.with_stored_count(error) from error
                raise
            if not is_decided:
                by_times = await in_pool(partial(_named_by_times, body, spool))
                more = 2 * len(spool)  # twice, since the names are read from the first one again
                if by_times is None and not body.ended and more <= body.room.most_of_key:
                    up_to = more
                    continue
                is_decided, up_to = True, batch
                if by_times:
                    await body.fill(spool)
                    await until_stored.enter_async_context(_held(lock, request))
                    again = partial(_again, body, spool)
                    await in_pool(partial(upload.order_by_time, again))
                body.rewind()
            pieces = body.unpacked(spool.pieces())
            while await in_pool(partial(_store_batch, upload, pieces)):
                pass
            await spool.empty()  # or what comes next might have no room
        return await in_pool(upload.finish)


@asynccontextmanager
async def _held(lock: asyncio.Lock, request: Request) -> AsyncIterator[None]:
    """Hold a lock in the block; another upload may hold it for hours, with this body in the spool.

    Raises:
        ClientDisconnect: If the client left before it was free.
    """
    client = Client()
    watching = asyncio.create_task(client.watch(request.receive))
    acquiring = asyncio.create_task(lock.acquire())
    try:
        await asyncio.wait({watching, acquiring}, return_when=asyncio.FIRST_COMPLETED)
        if client.left.is_set():
            raise ClientDisconnect
        await acquiring
        watching.cancel()
        yield
    finally:
        watching.cancel()
        if not acquiring.cancel() and not acquiring.cancelled():
            lock.release()


def _again(body: Incoming, spool: Spool) -> Iterator[bytes]:
    """Return the bytes of a spooled body from its first one on."""
    body.rewind()
    return body.unpacked(spool.pieces())


def _named_by_times(body: Incoming, spool: Spool) -> bool | None:
    """Return whether the first scan of a body, whose beginning is spooled, is named by its time.

    `None` if no name in it is a time or an index.
    """
    try:
        for member in listed(_again(body, spool)):
            if member_time_s(member) is not None:
                return True
            if is_index(member.name):
                return False
    except TensorMapError:  # is reported when its scans are stored
        return False
    return None


def _store_batch(upload: ScanUpload, pieces: Iterator[bytes]) -> bool:
    """Store the scans of the next megabytes, and return whether there may be more.

    Between two batches other keys have their turn.
    """
    taken = 0

    def batch() -> Iterator[bytes]:
        nonlocal taken
        for piece in pieces:
            taken += len(piece)
            yield piece
            if taken >= _BATCH_BYTES:
                return

    upload.take(batch())
    return taken >= _BATCH_BYTES


def _store_rest(upload: ScanUpload, body: Incoming, spool: Spool) -> None:
    """Store what was received before the body was cut off."""
    with suppress(TensorMapError):  # of two errors the first one is reported
        upload.take(body.unpacked(spool.pieces()))
        upload.store()
