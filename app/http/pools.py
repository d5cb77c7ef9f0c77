"""Pools of threads, shared fairly between keys."""

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import Awaitable, Callable, Hashable
from contextlib import AbstractContextManager, suppress
from functools import partial
from typing import Any, TypeVar

from anyio import CapacityLimiter, to_thread
from starlette.requests import ClientDisconnect

from app.http.client import Client
from app.http.errors import ServiceBusy, TooManyRequests
from app.loading import NotLoaded, without_loading
from app.quick_work import NotQuick, quickly
from app.settings import Settings
from core.errors import TensorMapError
from core.parallel import usable_cores

T = TypeVar("T")
_RETRY_S = 2
_SMALL_BYTES = 64 * 2**10
_ADMISSION_THREADS = 8  # looking a key up takes a fraction of a millisecond
_SPOOL_THREADS = 8
_AUDIT_THREADS = 2  # the catalog allows one writer at a time
_OPENING_THREADS = 1  # each more would delay the threads of requests
_QUIET_S = 0.01  # a match takes less
_INNER_THREADS = 40  # of the framework: files that are sent, streams
_LOADS = 4  # a track needs two, a revision and its tracker; either may be unloaded meanwhile


class Pool:
    """Threads that all keys share, each a part of them at most; waiting keys take turns.

    It is used on one event loop only and needs no lock.

    Args:
        name: The work's name, for messages.
        threads: How many calls run at once.
        per_key: How many of one key run at once.
        queue: How many wait at most, of one key half of that.
    """

    def __init__(self, name: str, threads: int, per_key: int, queue: int) -> None:
        self._name = name
        self._threads, self._per_key, self._queue = threads, min(per_key, threads), queue
        self._limiter = CapacityLimiter(threads)
        self._running: Counter[str] = Counter()
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()
        self._quiet = asyncio.Event()
        self._shared: dict[Hashable, asyncio.Task[Any]] = {}

    async def quiet(self) -> None:
        """Return when nothing runs, or after some milliseconds.

        Who moves many bytes on the event loop waits here between two pieces: the threads that
        answer would wait for the interpreter's lock at each of their dozens of large arrays.
        """
        if self._running:
            self._quiet.clear()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._quiet.wait(), _QUIET_S)

    @property
    def is_busy(self) -> bool:
        """Whether any work runs."""
        return bool(self._running)

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
            key: The sender whose work it is.
            work: Called in the thread.
            client: Who waits for it; if it leaves before the work begins, it is not done.
            begun: It continues earlier work, and may wait even if the queue is full.

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

    async def run_shared(self, key: str, name: Hashable, work: Callable[[], T]) -> T:
        """Return what `work` returns, from one thread for all keys that call it by that name.

        Until it has begun, each key waits for its own turn only: another one may have much work.

        Raises:
            TooManyRequests: If too much work of this key waits.
            ServiceBusy: If too much work waits.
        """
        if name not in self._shared:
            await self._enter(key, None, begun=False)
            try:
                if name not in self._shared:  # else it began meanwhile: the turn is given back
                    shared = asyncio.create_task(to_thread.run_sync(work, limiter=self._limiter))
                    self._shared[name] = shared
                    shared.add_done_callback(lambda _: self._shared.pop(name))
                    return await shared
            finally:
                self._leave(key)
        shared = self._shared[name]
        return await _result_of(shared)

    async def run_here(self, key: str, work: Callable[[], T]) -> T:
        """Return what `work` returns, called on the event loop: one call in each of its turns.

        What else the event loop has to do goes on between two calls.

        Raises:
            TooManyRequests: If too much work of this key waits.
            ServiceBusy: If too much work waits.
        """
        await self._enter(key, None, begun=False)
        try:
            return work()
        finally:
            asyncio.get_running_loop().call_soon(self._leave, key)

    async def _enter(self, key: str, client: Client | None, *, begun: bool) -> None:
        if self._has_room(key):
            self._running[key] += 1
            return
        if not begun:
            self._require_queue(key)
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(key, deque()).append(turn)
        ends: set[asyncio.Future[Any]] = {turn}
        left = asyncio.create_task(client.left.wait()) if client else None
        if left is not None:
            ends.add(left)
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if client and client.left.is_set():
                raise ClientDisconnect
        except BaseException:
            if turn.done():  # its turn came at the same time
                self._leave(key)
            else:
                self._waiting[key].remove(turn)
                if not self._waiting[key]:
                    del self._waiting[key]
            raise
        finally:
            if left is not None:
                left.cancel()

    def _has_room(self, key: str) -> bool:
        return self._running.total() < self._threads and self._running[key] < self._per_key

    def _require_queue(self, key: str) -> None:
        of_key, most_of_key = len(self._waiting.get(key, ())), max(1, self._queue // 2)
        if of_key >= most_of_key:
            raise TooManyRequests(
                f"the limit of {most_of_key} requests of a key that wait for {self._name} is"
                f" reached: wait {_RETRY_S} s",
                _RETRY_S,
            )
        if self.waiting >= self._queue:
            raise ServiceBusy(
                f"the limit of {self._queue} requests that wait for {self._name} is reached:"
                f" wait {_RETRY_S} s",
                _RETRY_S,
            )

    def _leave(self, key: str) -> None:
        """Start the next call: a key that had its turn goes behind the others."""
        self._running[key] -= 1
        if not self._running[key]:
            del self._running[key]
        if not self._running:
            self._quiet.set()
        waiting = next(filter(self._has_room, self._waiting), None)
        if waiting is None:
            return
        turns = self._waiting[waiting]
        self._running[waiting] += 1
        turns.popleft().set_result(None)
        if turns:
            self._waiting.move_to_end(waiting)
        else:
            del self._waiting[waiting]


class Pools:
    """The pools of a service.

    Attributes:
        short: Work of milliseconds: the catalog, localizing by signature.
        on_loop: Observations of tracks, and fixes by signature, that take a few milliseconds.
        matching: Other observations of streams. They compute only: with more threads than
            processors each takes longer, and so does all that the event loop does, as opening other
            streams.
        heavy: Longer work: scans, archives, closures, imports, comparisons, large JSON; packing and
            removing the files of drives; loading revisions for short work.
        admission: Threads that look up keys, and do nothing else.
        spool: Threads that write bodies to disk.
        audit: Threads that log rejected requests.
        opening: Threads that check who opens a stream, and find its track: thousands at once leave
            the other threads to requests.
    """

    def __init__(self, settings: Settings) -> None:
        self.short = Pool(
            "a short answer",
            settings.short_threads,
            max(1, settings.short_threads * 3 // 4),
            settings.queued_requests,
        )
        threads = min(usable_cores() + 1, settings.short_threads)
        self.matching = Pool(
            "an observation", threads, max(1, threads - 1), settings.queued_requests
        )
        self.on_loop = Pool("a quick answer", 1, 1, settings.queued_requests)
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
        self._loading: dict[Hashable, asyncio.Task[object]] = {}

    @staticmethod
    def is_short(length: int) -> bool:
        """Whether work on a body of so many bytes is short: that on large ones takes longer."""
        return length <= _SMALL_BYTES

    def of_body(self, length: int) -> Pool:
        """Return the pool of work on a body."""
        return self.short if self.is_short(length) else self.heavy

    def of_observation(self, length: int) -> Pool:
        """Return the pool of work on a message of a stream."""
        return self.matching if self.is_short(length) else self.heavy

    async def at_once(
        self,
        key: str,
        work: Callable[[], T],
        without_queries: Callable[[], AbstractContextManager[None]],
    ) -> T:
        """Return what quick work returns, called on the event loop when it is the sender's turn.

        Beside heavy work it is left to a thread: the event loop would wait for the interpreter's
        lock at each array, and all that it does would be late.

        Args:
            key: The sender whose work it is.
            work: As `quickly` takes it.
            without_queries: Returns such a block.

        Raises:
            NotQuick: If it is not, or heavy work runs: a thread is to do it.
            TooManyRequests: If too much work of this key waits.
            ServiceBusy: If too much work waits.
        """
        if self.heavy.is_busy:
            raise NotQuick
        return await self.on_loop.run_here(key, lambda: quickly(work, without_queries()))

    async def when_loaded(
        self,
        key: str,
        run: Callable[[Callable[[], T | NotLoaded]], Awaitable[T | NotLoaded]],
        work: Callable[[], T],
    ) -> T:
        """Return what short work returns, whose thread never waits for what takes long to load.

        That is loaded by heavy work, then the work begins again: before it has what it needs it
        must not change anything. All work that needs the same waits for one thread.

        Args:
            key: The sender whose work it is.
            run: Runs it in its own pool.
            work: Called in a thread.

        Raises:
            TooManyRequests: If too much work of this key waits.
            ServiceBusy: If too much work waits.
        """
        loaded = []  # in use until the work has it
        try:
            for _ in range(_LOADS):
                found = await run(partial(without_loading, work))
                if not isinstance(found, NotLoaded):
                    return found
                try:
                    loaded.append(await self._load(key, found))
                except TensorMapError:
                    break  # the work meets it again, and knows what to do
        finally:
            loaded.clear()  # a traceback may keep this frame
        return await self.heavy.run(key, work)

    async def _load(self, key: str, needed: NotLoaded) -> object:
        name = key, needed.name
        if (loading := self._loading.get(name)) is None:
            loading = asyncio.create_task(self.heavy.run_shared(key, needed.name, needed.load))
            self._loading[name] = loading
            loading.add_done_callback(partial(self._loaded, name))
        return await _result_of(loading)

    def _loaded(self, name: Hashable, loading: asyncio.Task[object]) -> None:
        del self._loading[name]
        if not loading.cancelled():
            loading.exception()  # all who waited for it may have left

    async def quiet(self) -> None:
        """Return when no answer is computed, or after some milliseconds: see `Pool.quiet`."""
        await self.short.quiet()
        await self.matching.quiet()

    def size_the_default(self) -> None:
        """Size the pool that the framework itself uses."""
        to_thread.current_default_thread_limiter().total_tokens = _INNER_THREADS


async def _result_of(task: asyncio.Task[T]) -> T:
    """Return what a task returns, which goes on if the one that waits for it is cancelled.

    So it would in `asyncio.shield`, which since Python 3.14 logs what fails when nobody waits.
    """
    await asyncio.wait([task])
    return task.result()
