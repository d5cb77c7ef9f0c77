"""Jobs, which run in the background: builds, and readings of captures."""

from collections.abc import AsyncIterator
from contextlib import AbstractContextManager
from typing import Annotated

from fastapi import Header, Path, Query, Request, Response, status
from starlette.responses import StreamingResponse
from starlette.types import Receive, Send
from starlette.types import Scope as ASGIScope

from app.access.api_router import api_router
from app.access.caller import Caller
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.http.errors import READING, WRITING, InvalidRequest, TooManyStreams, TooManyStreamsOfKey
from app.http.pages import After, Limit, PageOut, page_out
from app.http.problems import problems
from app.jobs.events import event_id
from app.jobs.schemas import JobOut
from app.service import Running, Service
from core.errors import InvalidParameters
from storage.catalog import JobRecord, JobState
from storage.errors import JobNotFound, MapNotFound

reading = api_router(tags=["builds"], dependencies=(needs(Scope.MAPS_READ, Scope.MAPS_WRITE),))
writing = api_router(tags=["builds"], dependencies=(needs(Scope.MAPS_WRITE),))

_EVENTS = "text/event-stream"
# OpenAPI 3.1 has no schema for each event; 3.2 has `itemSchema`.
_OF_EVENTS = {
    "type": "string",
    "description": "Server-sent events, each with `data`, a JobOut as JSON in one line, and `id`,"
    " for `Last-Event-ID`. A comment is sent where nothing changes for 15 s.",
}

JobId = Annotated[str, Path(alias="job", description="The job's id.")]
LastEventId = Annotated[
    str | None, Header(max_length=200, description="Id of the last event that the client received.")
]
OfMap = Annotated[str | None, Query(alias="map", description="Only the jobs of this map.")]
InStates = Annotated[
    list[JobState] | None,
    Query(alias="state", description="Only the jobs in one of these states; repeatable."),
]


@reading.get("/jobs", responses=problems(MapNotFound, InvalidParameters, InvalidRequest, *READING))
def list_jobs(
    running: Running,
    caller: CurrentCaller,
    map_slug: OfMap = None,
    states: InStates = None,
    after: After = "",
    limit: Limit = 100,
) -> PageOut[JobOut]:
    """List the jobs, newest first, those of maps within the limits of the key."""
    if map_slug is not None:
        caller.require_map(map_slug)
    page = running.store.jobs.list(map_slug, after, limit, slugs=caller.maps, states=states)
    return page_out(page, JobOut.from_record)


@reading.get("/jobs/{job}", responses=problems(JobNotFound, *READING))
def get_job(job_id: JobId, running: Running, caller: CurrentCaller) -> JobOut:
    """Show a job and its progress."""
    return JobOut.from_record(_job_of(running, caller, job_id))


@reading.get(
    "/jobs/{job}/events",
    response_class=Response,
    responses={
        200: {
            "description": "The job whenever it has changed.",
            "content": {_EVENTS: {"schema": _OF_EVENTS}},
        },
        204: {"description": "It has ended, and the client received its end: do not reconnect."},
        **problems(JobNotFound, InvalidRequest, TooManyStreams, TooManyStreamsOfKey, *READING),
    },
)
def follow_job(
    job_id: JobId,
    running: Running,
    caller: CurrentCaller,
    request: Request,
    last_event_id: LastEventId = None,
) -> Response:
    """Follow a job: an event now and whenever it changes, each the whole job as JSON.

    The stream ends when the job ends, the key is revoked, or the service stops. With
    `Last-Event-ID`, which a browser sends when it reconnects, an event that was received is not
    repeated.
    """
    record = _job_of(running, caller, job_id)
    if record.ended and last_event_id == event_id(record):
        return Response(status_code=status.HTTP_204_NO_CONTENT)
    events = running.job_events.follow(request, record, last_event_id)
    return _Followed(events, running.streams.opened(caller.key_id))


@writing.delete("/jobs/{job}", responses=problems(JobNotFound, *WRITING))
def cancel_job(job_id: JobId, running: Running, caller: CurrentCaller) -> JobOut:
    """Cancel a job: a waiting one at once, a running one within a second; one that ended stays."""
    job = _job_of(running, caller, job_id)
    note(job.kind, map_slug=job.map_slug)
    return JobOut.from_record(running.store.jobs.request_cancel(job.id))


class _Followed(StreamingResponse):
    """An answer that counts as an open stream from its first byte to its last."""

    def __init__(
        self, events: AsyncIterator[bytes], while_open: AbstractContextManager[None]
    ) -> None:
        # Proxies that buffer would delay the events.
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(events, media_type=_EVENTS, headers=headers)
        self._while_open = while_open

    async def __call__(self, scope: ASGIScope, receive: Receive, send: Send) -> None:
        with self._while_open:
            await super().__call__(scope, receive, send)


def _job_of(running: Service, caller: Caller, job_id: str) -> JobRecord:
    """Return a job of a map within the limits of the caller's key.

    Raises:
        JobNotFound: If there is none, for this caller.
    """
    job = running.store.jobs.get(job_id)
    if not caller.sees(job.map_slug):
        raise JobNotFound(f"there is no job {job_id[:80]!r}")
    return job
