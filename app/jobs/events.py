"""Jobs' server-sent events, continued from the last one that a client received."""

import asyncio
import contextvars
import logging
from collections.abc import AsyncIterator, Collection
from dataclasses import dataclass, field

from anyio import CapacityLimiter, to_thread
from fastapi.sse import format_sse_event
from starlette.requests import HTTPConnection

from app.access.access import Access
from app.http.errors import HostNotAllowed, KeyNeeded, KeyRefused
from app.jobs.schemas import JobOut
from app.outage import Outage
from storage.catalog import JobRecord
from storage.store import Store

_READ_EVERY_S = 0.25
_ALIVE_EVERY_S = 15.0  # proxies close connections that are silent for longer

_log = logging.getLogger("tensormap.jobs")


def event_id(record: JobRecord) -> str:
    """Return the id of a job's current event: its state, stage and progress.

    Each event is the whole job, so a client that reconnects with the id of its last event needs the
    current one only.
    """
    return f"{record.state}:{record.stage}:{record.done_units}:{record.total_units}"


@dataclass(eq=False)
class _Follower:
    """A client that follows a job.

    Attributes:
        connection: The connection of the client's request, with its key.
        record: The job when it was last read; `None` if it was deleted or the key was revoked.
        job_id: Id of the job.
        changed: Set with each new `record`.
    """

    connection: HTTPConnection
    record: JobRecord | None
    job_id: str
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def credentials(self) -> str:
        return self.connection.headers.get("authorization", "")


class JobEvents:
    """Follows jobs for any number of clients, and reads the jobs of all of them at once.

    Thousands of followers cost four queries a second for their jobs and four for each of their
    keys, and no thread of their own.

    Args:
        store: The store with the jobs.
        access: Checks the keys each time, so that a revoked one ends its streams.
    """

    def __init__(self, store: Store, access: Access) -> None:
        self._store = store
        self._access = access
        self._followers: set[_Follower] = set()
        self._reading: asyncio.Task[None] | None = None
        self._ending = False

    def end(self) -> None:
        """End all streams, on their event loop: a service that stops would wait for their jobs."""
        self._ending = True
        for follower in self._followers:
            follower.changed.set()

    async def follow(
        self, connection: HTTPConnection, record: JobRecord, seen: str | None
    ) -> AsyncIterator[bytes]:
        """Yield a job's events until it has ended or was deleted, the key is revoked, or `end`.

        Args:
            connection: The client's connection.
            record: The current job.
            seen: Id of the last event that the client received, `None` if none.
        """
        follower = _Follower(connection, record, record.id)
        self._followers.add(follower)
        if self._reading is None or self._reading.done():
            # In an empty context: its log lines belong to no request.
            self._reading = asyncio.get_running_loop().create_task(
                self._read_jobs(), context=contextvars.Context()
            )
        try:
            while (job := follower.record) is not None:
                follower.changed.clear()
                now = event_id(job)
                if now != seen:
                    seen = now
                    data = JobOut.from_record(job).model_dump_json()
                    yield format_sse_event(data_str=data, id=now)
                if job.ended or self._ending:
                    return
                while not follower.changed.is_set():
                    try:
                        await asyncio.wait_for(follower.changed.wait(), _ALIVE_EVERY_S)
                    except TimeoutError:
                        yield format_sse_event(comment="still here")
        finally:
            self._followers.discard(follower)

    async def _read_jobs(self) -> None:
        outage = Outage(_log, "followed jobs cannot be read")
        one_at_a_time = CapacityLimiter(1)
        while self._followers:
            await asyncio.sleep(_READ_EVERY_S)
            followers = tuple(self._followers)
            try:
                # Not asyncio's own threads: the end of its loop waits for these, however long.
                found = await to_thread.run_sync(self._read, followers, limiter=one_at_a_time)
            except Exception as error:  # noqa: BLE001 - it serves all followers, and tries again
                outage.failed(error)
                continue
            outage.over()
            for follower, record in zip(followers, found, strict=True):
                if record != follower.record:
                    follower.record = record
                    follower.changed.set()

    def _read(self, followers: Collection[_Follower]) -> list[JobRecord | None]:
        by_key = {f.credentials: f for f in followers}
        admits = {sent: self._admits(follower) for sent, follower in by_key.items()}
        jobs = self._store.jobs.with_ids({follower.job_id for follower in followers})
        return [jobs.get(f.job_id) if admits[f.credentials] else None for f in followers]

    def _admits(self, follower: _Follower) -> bool:
        try:
            self._access.caller_of(follower.connection)
        except (KeyRefused, KeyNeeded, HostNotAllowed):
            return False
        return True
