"""Tracks of the service are made for a vehicle, as few as can be if their answers are lost."""

import contextlib
import time
from functools import partial

import httpx2

from tensormap_client._async.bases import AsyncBases
from tensormap_client._async.pinned_track import AsyncPinnedTrack
from tensormap_client._async.transport import AsyncTransport
from tensormap_client.errors import ClientError, Rejected
from tensormap_client.io_async import AsyncKept
from tensormap_client.waits import Waits

# A track whose answer is lost counts towards the key's tracks until it is idle, 600 s by default.
_FIRST_WAIT_S, _LONGEST_WAIT_S = 2.0, 30.0
_OF_LOST_ANSWERS = {
    httpx2.codes.REQUEST_TIMEOUT,
    httpx2.codes.BAD_GATEWAY,
    httpx2.codes.GATEWAY_TIMEOUT,
}
_NEVER_SENT = (
    httpx2.ConnectError,
    httpx2.ConnectTimeout,
    httpx2.PoolTimeout,
    httpx2.ProxyError,
)


class AsyncTrackMaker:
    """Makes the tracks of a vehicle, one at a time.

    One that a caller stopped waiting for is that of the next caller.

    Args:
        transport: The connections to the service.
        bases: The map's bases.
        map_path: The map's path.
        timeout_s: How long to wait for an answer, in seconds.

    Attributes:
        failure: Why the answer to the last track may be lost, `None` before the first such failure.
    """

    def __init__(
        self, transport: AsyncTransport, bases: AsyncBases, map_path: str, timeout_s: float
    ) -> None:
        self.failure: ClientError | None = None
        create = partial(AsyncPinnedTrack.create, transport, bases, map_path, timeout_s)
        self._making = AsyncKept(create)
        self._waits, self._not_before_s = Waits(_FIRST_WAIT_S, _LONGEST_WAIT_S), 0.0

    @property
    def is_begun(self) -> bool:
        """Whether there is one that a caller stopped waiting for."""
        return self._making.is_begun

    @property
    def must_wait(self) -> bool:
        """Whether it is too early for another one, after one whose answer may be lost."""
        return not self.is_begun and time.monotonic() < self._not_before_s

    async def made(self) -> AsyncPinnedTrack:
        """Return a new track.

        Raises:
            ClientError: If there is none, as far as is known.
        """
        try:
            track = await self._making.result()
        except ClientError as error:
            if _may_be_made(error):
                self.failure = error
                self._not_before_s = time.monotonic() + self._waits.next_s()
            raise
        self._waits.begin_again()
        return track

    async def discard(self) -> None:
        """Remove the track that a caller stopped waiting for, when there is an answer."""
        if self.is_begun:
            with contextlib.suppress(ClientError):
                await (await self._making.result()).remove()


def _may_be_made(error: ClientError) -> bool:
    """Return whether the service may have made a track all the same."""
    if isinstance(error, Rejected):
        return error.status in _OF_LOST_ANSWERS
    cause = error.__cause__
    return isinstance(cause, httpx2.RequestError) and not isinstance(cause, _NEVER_SENT)
