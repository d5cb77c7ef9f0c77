"""Jobs: what the service does in the background."""

from typing import Annotated

from fastapi import APIRouter, Path, Query

from app.errors import READING, WRITING, InvalidRequest, problems
from app.schemas.jobs import JobOut
from app.schemas.pages import After, Limit, PageOut
from app.service import Running
from core.errors import InvalidParameters
from storage.errors import JobNotFound, MapNotFound

__all__ = ["router"]

router = APIRouter(tags=["builds"])

JobId = Annotated[str, Path(alias="job", description="The job's id.")]
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


@router.delete("/jobs/{job}", responses=problems(JobNotFound, *WRITING))
def cancel_job(job_id: JobId, running: Running) -> JobOut:
    """Cancel a job: a waiting one at once, a running one within a second; one that ended stays."""
    return JobOut.from_record(running.store.jobs.request_cancel(job_id))
