"""Where bodies are kept until they are complete: small ones in memory, then in a file."""

import asyncio
import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from os import SEEK_END
from tempfile import TemporaryFile
from typing import IO

from anyio import CapacityLimiter, to_thread

from app.http.errors import BodyTooLarge, ServiceBusy, TooManyRequests
from app.settings import Settings
from storage.files.files import named_disk_errors
from storage.files.free_space import OF_UPLOADS

_RETRY_S = 5
_SMALL_BYTES = 128 * 2**10  # of each body in memory
_LARGE_BYTES = 8 * 2**20  # of a body that finds room in the memory that all share
_SHARED_BYTES = 64 * 2**20
_PIECE_BYTES = 2**20  # read and written at once
_JOINED_BYTES = 16 * 2**10
_SLOW_BYTES = 16 * 2**20  # of a file: freeing them takes 8 ms, 3 GB of them 1.5 s

_log = logging.getLogger("tensormap.bodies")


class SpoolRoom:
    """The room that all incomplete bodies share; used on the event loop only.

    Args:
        settings: The settings, of which `max_spool_bytes`, `bodies_per_key` and `data_dir` apply.
        limiter: The limiter of the threads that write files.

    Attributes:
        folder: Where the files are.
        limiter: The limiter of the threads that write them.
        most_of_key: How many bytes of all bodies of one key are kept.
    """

    def __init__(self, settings: Settings, limiter: CapacityLimiter) -> None:
        self.folder = settings.data_dir
        self.limiter = limiter
        self._most_bytes = settings.max_spool_bytes
        # The rest is for other keys.
        self.most_of_key = self._most_bytes * 3 // 4
        self._bodies_per_key = settings.bodies_per_key
        self._bodies: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()
        self._total = 0
        self._shared = _SHARED_BYTES
        self._closing: set[asyncio.Task[None]] = set()

    @contextmanager
    def spool(self, key: str) -> Iterator["Spool"]:
        """Yield a place for a body of this key; its room is returned after the block.

        That of a large file is returned when it is closed.

        Raises:
            TooManyRequests: If the key's limit of bodies at a time is reached.
        """
        if self._bodies[key] >= self._bodies_per_key:
            raise TooManyRequests(
                f"the limit of {self._bodies_per_key} bodies of a key that are read at a time is"
                f" reached: wait {_RETRY_S} s",
                _RETRY_S,
            )
        self._bodies[key] += 1
        spool = Spool(self, key)
        try:
            yield spool
        finally:
            spool.clear()
            _subtract(self._bodies, key, 1)

    def take(self, key: str, amount: int) -> None:
        """Reserve room for so many bytes.

        Raises:
            ServiceBusy: If there is none.
        """
        if self._total + amount > self._most_bytes or self._bytes[key] + amount > self.most_of_key:
            raise ServiceBusy(
                f"{self._total} bytes of bodies wait to be read whole, at most {self._most_bytes}"
                f" are kept and {self.most_of_key} of one key: wait {_RETRY_S} s",
                _RETRY_S,
            )
        self._total += amount
        self._bytes[key] += amount

    def give_back(self, key: str, amount: int) -> None:
        """Release room."""
        self._total -= amount
        _subtract(self._bytes, key, amount)

    def close(self, key: str, amount: int, file: IO[bytes]) -> asyncio.Task[None] | None:
        """Close a file and release its room; in a thread if it has many bytes.

        They have no other name: the kernel frees them within the call, and until then the disk has
        no room for others.

        Args:
            key: The sender of the bytes.
            amount: How many bytes.
            file: Their file.

        Returns:
            What closes it, `None` if it is closed.
        """
        if amount <= _SLOW_BYTES:
            self.give_back(key, amount)
            file.close()
            return None
        closing = asyncio.create_task(self._close(key, amount, file))
        self._closing.add(closing)
        closing.add_done_callback(self._closing.discard)
        return closing

    async def closed(self, within_s: float | None = None) -> None:
        """Return when the files of bodies that were discarded are closed, or after some seconds."""
        if self._closing:
            await asyncio.wait(self._closing, timeout=within_s)

    async def _close(self, key: str, amount: int, file: IO[bytes]) -> None:
        try:
            await to_thread.run_sync(file.close, limiter=self.limiter)
        except OSError:  # as of a network's disk; nobody waits for it
            _log.exception("the file of a body cannot be closed")
        finally:
            file.close()  # if the event loop ends before a thread has begun; nothing else otherwise
            self.give_back(key, amount)

    def lend(self, amount: int) -> bool:
        """Reserve shared memory, and return whether there was enough."""
        if amount > self._shared:
            return False
        self._shared -= amount
        return True

    def return_memory(self, amount: int) -> None:
        """Release shared memory."""
        self._shared += amount


def _subtract(counted: Counter[str], key: str, amount: int) -> None:
    counted[key] -= amount
    if not counted[key]:
        del counted[key]


class Spool:
    """Received bytes; written on the event loop, read in a thread.

    Args:
        room: The shared room.
        key: The sender of the bytes.
    """

    def __init__(self, room: SpoolRoom, key: str) -> None:
        self._room, self._key = room, key
        self._memory: list[bytes] = []
        self._held = 0  # bytes in memory
        self._lent = 0
        self._length = 0
        self._file: IO[bytes] | None = None

    def __len__(self) -> int:
        return self._length

    async def write(self, chunk: bytes) -> None:
        """Add bytes.

        Raises:
            BodyTooLarge: If there is no room for so many, however few other bodies there are.
            ServiceBusy: If all bodies together take too much.
            StorageFull: If no space is left on the disk.
            StorageReadOnly: If the data directory cannot be written.
        """
        if self._length + len(chunk) > self._room.most_of_key:
            raise BodyTooLarge(
                f"more than {self._length} bytes of the body have to be kept until it is complete,"
                f" at most {self._room.most_of_key} are kept of one key: send it in parts"
            )
        self._room.take(self._key, len(chunk))
        self._length += len(chunk)
        self._keep(chunk)
        if self._held > _SMALL_BYTES + self._lent and not self._grows():
            # In a thread: a slow disk must not delay other requests.
            await to_thread.run_sync(self._write_out, limiter=self._room.limiter)
            self._return_memory()

    def pieces(self) -> Iterator[bytes]:
        """Yield all bytes from the first one on."""
        if self._file is not None:
            self._file.seek(0)
            while piece := self._file.read(_PIECE_BYTES):
                yield piece
        yield from self._memory

    async def empty(self) -> None:
        """Discard the bytes, and return when their room is released."""
        closing = self.clear()
        if closing is not None:
            await asyncio.wait({closing})

    def clear(self) -> asyncio.Task[None] | None:
        """Discard the bytes, and release their room: see `SpoolRoom.close`."""
        length, file = self._length, self._file
        self._length = self._held = 0
        self._memory, self._file = [], None
        self._return_memory()
        if file is not None:
            return self._room.close(self._key, length, file)
        self._room.give_back(self._key, length)
        return None

    def _keep(self, chunk: bytes) -> None:
        """Keep a chunk in memory; small ones are joined, since each takes some bytes more.

        One growing array would be copied again and again, on the event loop.
        """
        self._held += len(chunk)
        if self._memory and len(self._memory[-1]) + len(chunk) <= _JOINED_BYTES:
            self._memory[-1] += chunk
        elif chunk:
            self._memory.append(chunk)

    def _grows(self) -> bool:
        more = self._held - _SMALL_BYTES - self._lent
        most = _LARGE_BYTES if self._file is None else _PIECE_BYTES
        if self._held > most or not self._room.lend(more):
            return False
        self._lent += more
        return True

    def _write_out(self) -> None:
        with named_disk_errors():
            if self._file is None:
                # `clear` closes it.
                self._file = TemporaryFile(dir=self._room.folder, buffering=0)  # noqa: SIM115
            OF_UPLOADS.require(self._room.folder, self._held, "the next piece of a body")
            begin = self._file.seek(0, SEEK_END)  # who read it may have stopped before its end
            try:
                for chunk in self._memory:
                    view = memoryview(chunk)
                    while view:
                        view = view[self._file.write(view) :]
            except OSError:  # a part would be read twice: it is still in memory
                self._file.seek(begin)
                self._file.truncate()
                raise
        self._memory, self._held = [], 0

    def _return_memory(self) -> None:
        self._room.return_memory(self._lent)
        self._lent = 0
