"""A job's events: server-sent, from where the client last was."""

import asyncio
from collections.abc import AsyncIterator, Callable

from fastapi.sse import format_sse_event

from app.errors import KeyNeeded, KeyRefused
from app.schemas.jobs import JobOut
from storage.catalog import JobRecord
from storage.errors import JobNotFound

__all__ = ["event_id", "events_of"]

_LOOK_EVERY_S = 0.25
_ALIVE_EVERY_S = 15.0  # proxies close what is silent for longer


def event_id(record: JobRecord) -> str:
    """Return what tells one event of a job from another: its state, stage and progress.

    Each event is the whole job as it then was, so a client that comes back with the id of the last
    one that it saw misses nothing by being told the present one only.
    """
    return f"{record.state}:{record.stage}:{record.done_units}:{record.total_units}"


async def events_of(read: Callable[[], JobRecord], seen: str | None) -> AsyncIterator[bytes]:
    """Tell a job whenever it has got further, until it has ended, is gone, or is not told any more.

    Args:
        read: Gives the job as it is now; it may wait for the catalog.
        seen: Id of the last event that the client was told, `None` if none.
    """
    silent_s = 0.0
    while True:
        try:
            record = await asyncio.to_thread(read)
        except (JobNotFound, KeyRefused, KeyNeeded):  # gone with its map, or the key is revoked
            return
        now = event_id(record)
        if now != seen:
            seen, silent_s = now, 0.0
            yield format_sse_event(data_str=JobOut.from_record(record).model_dump_json(), id=now)
        if record.ended:
            return
        if silent_s >= _ALIVE_EVERY_S:
            silent_s = 0.0
            yield format_sse_event(comment="still here")
        await asyncio.sleep(_LOOK_EVERY_S)
        silent_s += _LOOK_EVERY_S
