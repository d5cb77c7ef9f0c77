"""A request body while it is received: its limits, its rate and its digest."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive

from app.http.bodies.content_digest import ContentDigest
from app.http.bodies.content_encoding import Decoder
from app.http.bodies.spool import Spool, SpoolRoom
from app.http.errors import BodyTooLarge, SlowBody
from app.settings import Settings

_SMALL_BYTES = 64 * 2**10
_STRIPPED = b"\n", b"\r", b"\0"  # `curl -d` does not send these of a file


class Pace:
    """Receives the parts of one body; the time that we take between two does not count.

    A body may lag behind the minimum rate by what that rate sends in the grace; a faster start does
    not earn more than that. There is no limit of the total time.

    Args:
        settings: The settings, of which `body_idle_s`, `body_grace_s` and `body_bytes_per_s` apply.
    """

    def __init__(self, settings: Settings) -> None:
        self._idle_s = settings.body_idle_s
        self._rate = settings.body_bytes_per_s
        self._most_left = self._left = self._rate * settings.body_grace_s

    async def next(self, receive: Receive) -> Message:
        """Return the next part of the body.

        Raises:
            SlowBody: If the body is slower.
        """
        patience_s = min(self._idle_s, self._left / self._rate) if self._rate else self._idle_s
        began_s = time.monotonic()
        try:
            async with asyncio.timeout(patience_s):
                message = await receive()
        except TimeoutError:
            if patience_s >= self._idle_s:
                raise SlowBody(f"nothing of the body arrived for {self._idle_s:g} s") from None
            raise SlowBody(
                f"the body arrives slower than {self._rate:g} bytes a second, the minimum"
            ) from None
        lag = (time.monotonic() - began_s) * self._rate
        self._left = min(self._most_left, self._left - lag + len(message.get("body", b"")))
        return message


@dataclass(eq=False)
class Incoming:
    """The body of one request.

    Attributes:
        receive: Returns its parts.
        sent_limit: Largest number of bytes that are received.
        unpacked_limit: Largest number of bytes after decompression.
        decoder: Decompresses it, `None` if it is not compressed.
        digest: The digest that it must have.
        pace: The body's minimum rate.
        spend: Counts bytes against the quota of the sender: those that came now, and all until now.
        room: The room that keeps the body until it is complete.
        key: The sender of the body.
        give_way: Called between two pieces of a large body: answers go first.
        ended: Whether all of it was received.
        is_stripped: Whether what was received has none of the bytes that `curl -d` leaves out.
    """

    receive: Receive
    sent_limit: int
    unpacked_limit: int
    decoder: Decoder | None
    digest: ContentDigest
    pace: Pace
    spend: Callable[[int, int], None]
    room: SpoolRoom
    key: str
    give_way: Callable[[], Awaitable[None]]
    ended: bool = field(default=False, init=False)
    is_stripped: bool = field(default=True, init=False)
    _received: int = field(default=0, init=False)

    @property
    def is_partial(self) -> bool:
        """Whether a part of it was received, and the rest was not."""
        return self._received > 0 and not self.ended

    @property
    def packed(self) -> bool:
        """Whether it is compressed."""
        return self.decoder is not None

    @property
    def has_digest(self) -> bool:
        """Whether it was sent with a digest."""
        return bool(self.digest)

    def spool(self) -> AbstractContextManager[Spool]:
        """Return a place for its bytes within the block.

        Raises:
            TooManyRequests: If its key's limit of bodies at a time is reached.
        """
        return self.room.spool(self.key)

    async def fill(self, spool: Spool, up_to: int | None = None) -> None:
        """Receive until its end, or until `up_to` bytes are spooled; these stay when it raises.

        Raises:
            SlowBody: If it arrives too slowly.
            BodyTooLarge: If it is too long, too long to be kept until it is complete, or longer
                than the quota of its sender.
            TooManyRequests: If it exceeds the rest of that quota.
            DigestMismatch: If its digest is another.
            ServiceBusy: If all bodies together take too much.
            StorageFull: If no space is left on the disk.
            StorageReadOnly: If the data directory cannot be written.
            ClientDisconnect: If the connection is cut.
        """
        while not self.ended and (up_to is None or len(spool) < up_to):
            message = await self.pace.next(self.receive)
            if message["type"] != "http.request":
                raise ClientDisconnect
            chunk = message.get("body", b"")
            self._received += len(chunk)
            self.is_stripped &= not any(byte in chunk for byte in _STRIPPED)
            if self._received > self.sent_limit:
                raise BodyTooLarge(
                    f"the body is longer than the {self.sent_limit} bytes that are read"
                )
            self.spend(len(chunk), self._received)
            self.digest.add(chunk)
            await spool.write(chunk)
            if not message.get("more_body", False):
                self.ended = True
                self.digest.check()
            elif self._received > _SMALL_BYTES:
                await self.give_way()

    def rewind(self) -> None:
        """Decompress from the first byte again: a spool is read a second time."""
        if self.decoder is not None:
            self.decoder = self.decoder.again()

    def unpacked(self, pieces: Iterator[bytes]) -> Iterator[bytes]:
        """Yield its decompressed bytes; in a thread, because a few bytes may become many.

        Raises:
            MalformedBody: If they cannot be decompressed, or are incomplete at the body's end.
            BodyTooLarge: If they become too many.
        """
        if self.decoder is None:
            yield from pieces
            return
        left = self.unpacked_limit
        for packed in pieces:
            for piece in self.decoder.feed(packed):
                left -= len(piece)
                if left < 0:
                    raise BodyTooLarge(
                        f"the body unpacks to more than the {self.unpacked_limit} bytes that may be"
                    )
                yield piece
        if self.ended:
            self.decoder.finish()
