"""Builds: from the scans of a map to a revision of it."""

from fastapi import APIRouter, Response, status

from app.errors import JSON_BODY, WRITING, problems
from app.jobs.parameters import BuildParameters
from app.schemas.jobs import JobOut
from app.service import MapSlug, Running
from core.errors import EmptyDrive, InvalidParameters
from storage.errors import DriveNotFound, MapNotFound

__all__ = ["router"]

router = APIRouter(tags=["builds"])


@router.post(
    "/maps/{map}/builds",
    status_code=status.HTTP_202_ACCEPTED,
    responses=problems(
        MapNotFound, DriveNotFound, EmptyDrive, InvalidParameters, *JSON_BODY, *WRITING
    ),
)
def build(
    map_slug: MapSlug, parameters: BuildParameters, running: Running, response: Response
) -> JobOut:
    """Queue a build; follow it at `Location`.

    What can be refused now is refused now: unknown drives, a map without scans, parameters that do
    not fit the sensor.
    """
    parameters.map_parameters()
    drives = parameters.drives or running.store.drives.slugs(map_slug)
    for drive in drives:
        if running.store.drives.get(map_slug, drive).scans == 0:
            raise EmptyDrive(f"drive {drive!r} has no scan")
    if not drives:
        raise EmptyDrive(f"map {map_slug!r} has no drive: upload scans first")
    job = running.store.jobs.create(map_slug, parameters.as_json())
    running.runner.wake()
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return JobOut.from_record(job)
