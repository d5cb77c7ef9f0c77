"""Jobs' events: server-sent, from where the client last was."""

import asyncio
import contextvars
import logging
from collections.abc import AsyncIterator, Collection
from dataclasses import dataclass, field

from fastapi.sse import format_sse_event
from starlette.requests import HTTPConnection

from app.access.access import Access
from app.builds.job_schemas import JobOut
from app.http.errors import HostNotAllowed, KeyNeeded, KeyRefused
from storage.catalog import JobRecord
from storage.store import Store

_LOOK_EVERY_S = 0.25
_ALIVE_EVERY_S = 15.0  # proxies close what is silent for longer

_log = logging.getLogger("tensormap.jobs")


def event_id(record: JobRecord) -> str:
    """Return what tells one event of a job from another: its state, stage and progress.

    Each event is the whole job as it then was, so a client that comes back with the id of the last
    one that it saw misses nothing by being told the present one only.
    """
    return f"{record.state}:{record.stage}:{record.done_units}:{record.total_units}"


@dataclass(eq=False)
class _Follower:
    """A client that follows a job.

    Attributes:
        connection: Of its request, with its key.
        record: The job as it was last; `None` once it is gone or not shown to this client any more.
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
    """Follows jobs for any number of clients, and reads them all at once for all of them.

    Thousands of followers cost four queries a second for their jobs and four for each of their
    keys, and no thread of their own.

    Args:
        store: Where jobs are.
        access: Who may follow them; asked again and again, so that a revoke holds.
    """

    def __init__(self, store: Store, access: Access) -> None:
        self._store = store
        self._access = access
        self._followers: set[_Follower] = set()
        self._looking: asyncio.Task[None] | None = None

    async def follow(
        self, connection: HTTPConnection, record: JobRecord, seen: str | None
    ) -> AsyncIterator[bytes]:
        """Yield a job's events until it has ended, is gone, or the key is revoked.

        Args:
            connection: Of the client.
            record: The job as it is now.
            seen: Id of the last event that the client was sent, `None` if none.
        """
        follower = _Follower(connection, record, record.id)
        self._followers.add(follower)
        self._keep_looking()
        try:
            while (job := follower.record) is not None:
                follower.changed.clear()
                now = event_id(job)
                if now != seen:
                    seen = now
                    data = JobOut.from_record(job).model_dump_json()
                    yield format_sse_event(data_str=data, id=now)
                if job.ended:
                    return
                while not await _is_set_within(follower.changed, _ALIVE_EVERY_S):
                    yield format_sse_event(comment="still here")
        finally:
            self._followers.discard(follower)

    def _keep_looking(self) -> None:
        if self._looking is None or self._looking.done():
            # In no request's context: what it logs is of no request.
            context = contextvars.Context()
            self._looking = asyncio.get_running_loop().create_task(self._look(), context=context)

    async def _look(self) -> None:
        while self._followers:
            await asyncio.sleep(_LOOK_EVERY_S)
            followers = tuple(self._followers)
            try:
                found = await asyncio.to_thread(self._read, followers)
            except Exception:  # noqa: BLE001 - it serves all followers; the next look may be luckier
                _log.exception("followed jobs cannot be read")
                continue
            for follower, record in zip(followers, found, strict=True):
                if record != follower.record:
                    follower.record = record
                    follower.changed.set()

    def _read(self, followers: Collection[_Follower]) -> list[JobRecord | None]:
        admitted = {f.credentials: f for f in followers}
        admits = {sent: self._admits(one) for sent, one in admitted.items()}
        jobs = self._store.jobs.with_ids({follower.job_id for follower in followers})
        return [jobs.get(f.job_id) if admits[f.credentials] else None for f in followers]

    def _admits(self, follower: _Follower) -> bool:
        try:
            self._access.caller_of(follower.connection)
        except (KeyRefused, KeyNeeded, HostNotAllowed):
            return False
        return True


async def _is_set_within(event: asyncio.Event, seconds: float) -> bool:
    try:
        async with asyncio.timeout(seconds):
            return await event.wait()
    except TimeoutError:
        return False
