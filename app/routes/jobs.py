"""Jobs: what the service does in the background."""

from typing import Annotated

from fastapi import APIRouter, Header, Path, Query, Response, status
from starlette.responses import StreamingResponse

from app.errors import READING, WRITING, InvalidRequest, problems
from app.job_events import event_id, events_of
from app.schemas.jobs import JobOut
from app.schemas.pages import After, Limit, PageOut
from app.service import Running
from core.errors import InvalidParameters
from storage.errors import JobNotFound, MapNotFound

__all__ = ["router"]

router = APIRouter(tags=["builds"])

_EVENTS = "text/event-stream"

JobId = Annotated[str, Path(alias="job", description="The job's id.")]
LastEventId = Annotated[
    str | None, Header(max_length=200, description="Of the last event that the client was told.")
]
OfMap = Annotated[str | None, Query(alias="map", description="Only the jobs of this map.")]


@router.get("/jobs", responses=problems(MapNotFound, InvalidParameters, InvalidRequest, *READING))
def list_jobs(
    running: Running, map_slug: OfMap = None, after: After = "", limit: Limit = 100
) -> PageOut[JobOut]:
    """List the jobs, newest first."""
    page = running.store.jobs.list(map_slug, after, limit)
    return PageOut(items=[JobOut.from_record(r) for r in page.items], next_after=page.next_after)


@router.get("/jobs/{job}", responses=problems(JobNotFound, *READING))
def get_job(job_id: JobId, running: Running) -> JobOut:
    """Show a job and how far it is."""
    return JobOut.from_record(running.store.jobs.get(job_id))


@router.get(
    "/jobs/{job}/events",
    response_class=Response,
    responses={
        200: {"description": "The job whenever it has got further.", "content": {_EVENTS: {}}},
        204: {"description": "It has ended, and the client was told so: do not come back."},
        **problems(JobNotFound, InvalidRequest, *READING),
    },
)
def follow_job(job_id: JobId, running: Running, last_event_id: LastEventId = None) -> Response:
    """Follow a job: an event now and whenever it has got further, each the whole job as JSON.

    The stream ends when the job has. `Last-Event-ID`, as a browser sends it when it comes back,
    leaves out what was seen.
    """
    record = running.store.jobs.get(job_id)
    if record.ended and last_event_id == event_id(record):
        return Response(status_code=status.HTTP_204_NO_CONTENT)
    events = events_of(lambda: running.store.jobs.get(job_id), last_event_id)
    # Proxies that buffer would hold back what is meant for now.
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(events, media_type=_EVENTS, headers=headers)


@router.delete("/jobs/{job}", responses=problems(JobNotFound, *WRITING))
def cancel_job(job_id: JobId, running: Running) -> JobOut:
    """Cancel a job: a waiting one at once, a running one within a second; one that ended stays."""
    return JobOut.from_record(running.store.jobs.request_cancel(job_id))
