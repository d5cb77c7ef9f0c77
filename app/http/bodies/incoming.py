"""A body on its way in: within its limits, at its pace, and as its digest says."""

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from starlette.requests import ClientDisconnect
from starlette.types import Receive

from app.http.bodies.content_digest import ContentDigest
from app.http.bodies.content_encoding import Decoder
from app.http.bodies.pace import Pace
from app.http.bodies.spool import Spool, SpoolRoom
from app.http.errors import BodyTooLarge


@dataclass(frozen=True)
class Limits:
    """How long a body may be.

    Attributes:
        sent: Bytes as they come.
        unpacked: Bytes of what they unpack to.
    """

    sent: int
    unpacked: int


class Incoming:
    """The body of one request.

    Args:
        receive: Gives its parts.
        limits: How long it may be.
        decoder: What unpacks it, `None` if it is not packed.
        digest: What it must have.
        pace: How slowly it may come.
        spend: Counts bytes against what the sender may send.
        room: Where it waits.
        key: Whose it is.
    """

    def __init__(
        self,
        receive: Receive,
        *,
        limits: Limits,
        decoder: Decoder | None,
        digest: ContentDigest,
        pace: Pace,
        spend: Callable[[int], None],
        room: SpoolRoom,
        key: str,
    ) -> None:
        self._receive = receive
        self._limits = limits
        self._decoder = decoder
        self._digest = digest
        self._pace = pace
        self._spend = spend
        self._room = room
        self._key = key
        self._sent = 0
        self._ended = False

    @property
    def ended(self) -> bool:
        """Whether all of it came."""
        return self._ended

    @property
    def is_coming(self) -> bool:
        """Whether a part of it was read, and the rest was not."""
        return self._sent > 0 and not self._ended

    @property
    def packed(self) -> bool:
        """Whether it must be unpacked."""
        return self._decoder is not None

    @property
    def has_digest(self) -> bool:
        """Whether it says what it is."""
        return bool(self._digest)

    @asynccontextmanager
    async def spool(self) -> AsyncIterator[Spool]:
        """Give a place for its bytes until the block ends.

        Raises:
            TooManyRequests: If its key sends as many bodies as it may.
        """
        with self._room.body(self._key):
            spool = Spool(self._room, self._key)
            try:
                yield spool
            finally:
                spool.clear()

    async def fill(self, spool: Spool, up_to: int | None = None) -> None:
        """Read until it has ended, or `up_to` bytes wait; what came stays when it raises.

        Raises:
            SlowBody: If it comes too slowly.
            BodyTooLarge: If it is longer than may be.
            TooManyRequests: If it is more than its sender may send.
            DigestMismatch: If it is not what its digest says.
            ServiceBusy: If all bodies together take too much.
            StorageFull: If no space is left on the disk.
            StorageReadOnly: If the data directory cannot be written.
            ClientDisconnect: If the connection is cut.
        """
        while not self._ended and (up_to is None or len(spool) < up_to):
            message = await self._pace.next(self._receive)
            if message["type"] != "http.request":
                raise ClientDisconnect
            chunk = message.get("body", b"")
            self._sent += len(chunk)
            if self._sent > self._limits.sent:
                raise BodyTooLarge(
                    f"the body is longer than the {self._limits.sent} bytes that are read"
                )
            self._spend(len(chunk))
            self._digest.add(chunk)
            await spool.write(chunk)
            if not message.get("more_body", False):
                self._ended = True
                self._digest.check()

    def unpacked(self, pieces: Iterator[bytes]) -> Iterator[bytes]:
        """Yield what its bytes unpack to; in a thread, because a few bytes may become many.

        Raises:
            MalformedBody: If they do not unpack, or all came and more should have.
            BodyTooLarge: If they unpack to more than may be.
        """
        if self._decoder is None:
            yield from pieces
            return
        left = self._limits.unpacked
        for packed in pieces:
            for piece in self._decoder.feed(packed):
                left -= len(piece)
                if left < 0:
                    raise BodyTooLarge(
                        f"the body unpacks to more than the {self._limits.unpacked} bytes that"
                        " may be"
                    )
                yield piece
        if self._ended:
            self._decoder.finish()
