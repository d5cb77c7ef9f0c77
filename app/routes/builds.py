"""Builds: from the scans of a map to a revision of it."""

from fastapi import APIRouter, Response, status

from app.access.scopes import Scope, needs
from app.errors import JSON_BODY, WRITING, problems
from app.jobs.parameters import BuildParameters
from app.plans import plan_build
from app.schemas.jobs import JobOut
from app.service import MapSlug, Running
from app.stored_images import require_images
from core.errors import EmptyDrive, InvalidParameters, UnknownDrive
from storage.errors import (
    AmbiguousRevision,
    CorruptFile,
    DriveNotFound,
    MapNotFound,
    NoLiveRevision,
    ReturnsGone,
    RevisionNotFound,
)

__all__ = ["router"]

router = APIRouter(tags=["builds"])


@router.post(
    "/maps/{map}/builds",
    dependencies=[needs(Scope.MAPS_WRITE)],
    status_code=status.HTTP_202_ACCEPTED,
    responses=problems(
        MapNotFound,
        DriveNotFound,
        UnknownDrive,
        NoLiveRevision,
        RevisionNotFound,
        AmbiguousRevision,
        EmptyDrive,
        InvalidParameters,
        CorruptFile,
        ReturnsGone,
        *JSON_BODY,
        *WRITING,
    ),
)
def build(
    map_slug: MapSlug, parameters: BuildParameters, running: Running, response: Response
) -> JobOut:
    """Queue a build; follow it at `Location`.

    What can be refused now is refused now: unknown drives, a base that is not there, a map without
    scans, parameters that do not fit the sensor, images of returns that were dropped.

    With `base`, the new revision is that one with the drives of `add` after its own and without
    those of `remove`. A harmonic map keeps its basis, so that the signatures of vehicles stay good,
    until `refit` asks for another. Nothing that is stored is removed.
    """
    record = running.store.maps.get(map_slug)
    plan = plan_build(running.store, record.id, parameters)
    require_images(running.store, record.id, plan.drives, plan.parameters.map_parameters())
    job = running.store.jobs.create(map_slug, plan.parameters.as_json())
    running.runner.wake()
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return JobOut.from_record(job)
