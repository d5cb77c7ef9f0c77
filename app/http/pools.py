"""Pools of threads: what runs at once, of whom, and who is next."""

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from anyio import CapacityLimiter, to_thread
from starlette.requests import ClientDisconnect

from app.http.client import Client
from app.http.errors import ServiceBusy, TooManyRequests
from app.settings import Settings

T = TypeVar("T")
_RETRY_S = 2
_SMALL_BYTES = 64 * 2**10
_ADMISSION_THREADS = 8  # a look-up of a key takes the catalog a fraction of a millisecond
_SPOOL_THREADS = 8
_AUDIT_THREADS = 2  # the catalog takes one writer at a time
_OPENING_THREADS = 1  # each that computes takes turns with all that answers others
_INNER_THREADS = 40  # of the framework: files that are sent, streams


class Pool:
    """Threads that all keys share, each a part of them at most; keys that wait take turns.

    It is used on one event loop only and needs no lock.

    Args:
        name: Of what runs here, for messages.
        threads: How many run at once.
        per_key: How many of one key run at once.
        queue: How many wait at most, of one key half of that.
    """

    def __init__(self, name: str, threads: int, per_key: int, queue: int) -> None:
        self._name = name
        self._threads, self._per_key, self._queue = threads, min(per_key, threads), queue
        self._limiter = CapacityLimiter(threads)
        self._running: Counter[str] = Counter()
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()

    @property
    def waiting(self) -> int:
        """How many wait for a thread."""
        return sum(map(len, self._waiting.values()))

    async def run(
        self,
        key: str,
        work: Callable[[], T],
        *,
        client: Client | None = None,
        begun: bool = False,
    ) -> T:
        """Return what `work` returns, from a thread.

        Args:
            key: Whose work it is.
            work: What to do.
            client: Who waits for it; when it leaves before the work began, that is left out.
            begun: It goes on with what was begun: it waits however many do.

        Raises:
            TooManyRequests: If too much work of this key waits.
            ServiceBusy: If too much work waits.
            ClientDisconnect: If the client left before the work began.
        """
        await self._enter(key, client, begun=begun)
        try:
            return await to_thread.run_sync(work, limiter=self._limiter)
        finally:
            self._leave(key)

    async def _enter(self, key: str, client: Client | None, *, begun: bool) -> None:
        if self._has_room(key):
            self._running[key] += 1
            return
        if not begun:
            self._require_queue(key)
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(key, deque()).append(turn)
        try:
            await self._wait(turn, client)
        except BaseException:
            if turn.done() and not turn.cancelled():  # its turn came at the same moment
                self._leave(key)
            else:
                self._forget(key, turn)
            raise

    @staticmethod
    async def _wait(turn: asyncio.Future[None], client: Client | None) -> None:
        if client is None:
            await turn
            return
        left = asyncio.ensure_future(client.left.wait())
        either: set[asyncio.Future[Any]] = {turn, left}
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        finally:
            left.cancel()
        if client.left.is_set():
            raise ClientDisconnect

    def _has_room(self, key: str) -> bool:
        return self._running.total() < self._threads and self._running[key] < self._per_key

    def _require_queue(self, key: str) -> None:
        of_key, most_of_key = len(self._waiting.get(key, ())), max(1, self._queue // 2)
        if of_key >= most_of_key:
            raise TooManyRequests(
                f"{of_key} requests of this key wait for {self._name}, as many as may:"
                f" wait {_RETRY_S} s",
                _RETRY_S,
                {},
            )
        if self.waiting >= self._queue:
            raise ServiceBusy(
                f"{self._queue} requests wait for {self._name}, as many as may: wait {_RETRY_S} s",
                _RETRY_S,
            )

    def _leave(self, key: str) -> None:
        self._running[key] -= 1
        if not self._running[key]:
            del self._running[key]
        self._start_next()

    def _start_next(self) -> None:
        """Let those in whose turn it is: a key that was served goes behind the others."""
        for key in list(self._waiting):
            if not self._has_room(key):
                continue
            turns = self._waiting[key]
            turn = turns.popleft()
            if turns:
                self._waiting.move_to_end(key)
            else:
                del self._waiting[key]
            self._running[key] += 1
            turn.set_result(None)
            return

    def _forget(self, key: str, turn: asyncio.Future[None]) -> None:
        turns = self._waiting.get(key, deque())
        with suppress(ValueError):
            turns.remove(turn)
        if not turns:
            self._waiting.pop(key, None)


class Pools:
    """The pools of a service.

    Attributes:
        short: What takes milliseconds: the catalog, a fix by signature.
        heavy: What takes longer: scans, archives, closures, imports, comparisons, large JSON.
        admission: Threads that look up keys; nobody's work takes one.
        spool: Threads that write bodies to disk.
        audit: Threads that log refusals, of whoever asks too often for what is not allowed.
        opening: Threads that check who opens a stream: thousands that come at once leave the others
            to requests.
    """

    def __init__(self, settings: Settings) -> None:
        self.short = Pool(
            "a short answer",
            settings.short_threads,
            max(1, settings.short_threads * 3 // 4),
            settings.queued_requests,
        )
        self.heavy = Pool(
            "heavy work",
            settings.heavy_threads,
            settings.heavy_threads_per_key,
            settings.queued_requests,
        )
        self.admission = CapacityLimiter(_ADMISSION_THREADS)
        self.spool = CapacityLimiter(_SPOOL_THREADS)
        self.audit = CapacityLimiter(_AUDIT_THREADS)
        self.opening = CapacityLimiter(_OPENING_THREADS)

    def of_body(self, length: int) -> Pool:
        """Return the pool of work on a body: what is large takes longer wherever it goes."""
        return self.heavy if length > _SMALL_BYTES else self.short

    def size_the_default(self) -> None:
        """Size the pool that the framework takes threads from by itself."""
        to_thread.current_default_thread_limiter().total_tokens = _INNER_THREADS
