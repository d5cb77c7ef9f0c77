"""Drives: list, change, close and delete them; PUT and GET of a single scan."""

import io
from typing import Annotated

import numpy as np
from fastapi import Path, Query, Response, status
from pydantic import BeforeValidator

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.drives.pose_query import PoseQuery, pose_from_query
from app.drives.schemas import DriveIn, DriveOut, DrivePatch, ScanOut
from app.http import errors
from app.http.answer_headers import CONTENT_DISPOSITION, LOCATION, headed
from app.http.bodies.bodies import SCAN_TYPES, Body, ContentType, Json, described_body
from app.http.exact_types import Seconds, in_digits
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import heavy, heavy_if
from app.http.problems import problems
from app.http.slugs import DriveSlug, MapSlug
from app.recycle_bin.purging import Purge, require_purge
from app.service import Running
from core.errors import InvalidParameters, InvalidPose
from core.numbers import nan_if_none
from core.scans.trajectory import SCAN_INDEX_LIMIT
from storage import errors as stored
from storage.formats.scans.registry import read_scan

scans = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_READ),))
reading = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_READ, Scope.MAPS_WRITE),))
writing = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_WRITE),))

_DRIVE = (stored.MapNotFound, stored.DriveNotFound)

ScanIndex = Annotated[
    int,
    Path(alias="index", ge=0, lt=SCAN_INDEX_LIMIT, description="The scan's index in the drive."),
    BeforeValidator(in_digits),
]
TimestampQuery = Annotated[
    Seconds | None, Query(description="When the scan was taken, in seconds.")
]

_NPY = "application/vnd.tensormap.npy"


@reading.get(
    "/maps/{map}/drives",
    responses=problems(stored.MapNotFound, errors.InvalidRequest, *errors.READING),
)
def list_drives(
    map_slug: MapSlug, running: Running, after: After = "", limit: Limit = 100
) -> PageOut[DriveOut]:
    """List a map's drives by name."""
    page = running.store.drives.list(map_slug, after, limit)
    return page_out(page, DriveOut.from_record)


@reading.get(
    "/maps/{map}/drives/{drive}",
    responses=problems(*_DRIVE, *errors.READING),
)
def get_drive(map_slug: MapSlug, drive_slug: DriveSlug, running: Running) -> DriveOut:
    """Show a drive: which scans are stored, and which are missing."""
    return DriveOut.from_record(running.store.drives.get(map_slug, drive_slug))


@writing.put(
    "/maps/{map}/drives/{drive}",
    status_code=status.HTTP_201_CREATED,
    responses={
        201: headed(LOCATION),
        200: {"model": DriveOut, "description": "The drive was there and is changed."},
        **problems(
            stored.MapNotFound,
            stored.InvalidSlug,
            stored.ReturnsGone,
            *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
)
def put_drive(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    sent: Json[DriveIn],
    running: Running,
    response: Response,
) -> DriveOut:
    """Set how builds read a drive, its sensor's mounting above all; a new drive is created.

    Revisions that were built before stay as they are. Once returns of its scans were dropped after
    a build, it can no longer be changed.
    """
    mounting = None if sent.mounting is None else sent.mounting.to_core()
    note(f"mounting {mounting or 'none'}, accumulate {sent.accumulate}")
    put, is_new = running.store.drives.put(map_slug, drive_slug, mounting, sent.accumulate)
    if is_new:
        response.headers[LOCATION] = f"/v1/maps/{map_slug}/drives/{drive_slug}"
    else:
        response.status_code = status.HTTP_200_OK
    return DriveOut.from_record(put)


@writing.patch(
    "/maps/{map}/drives/{drive}",
    responses=problems(*_DRIVE, *errors.JSON_BODY, *errors.WRITING),
)
@heavy
def close_drive(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    change: Json[DrivePatch],  # noqa: ARG001 - its schema allows one change only
    running: Running,
) -> DriveOut:
    """Close a drive: it takes no new scans, and its files are packed."""
    closed = running.store.drives.close(map_slug, drive_slug)
    running.collector.wake(map_slug)
    return DriveOut.from_record(closed)


@writing.delete(
    "/maps/{map}/drives/{drive}",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(*_DRIVE, errors.InvalidRequest, *errors.WRITING),
)
@heavy_if(lambda given: given["purge"])
def delete_drive(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    running: Running,
    caller: CurrentCaller,
    purge: Purge = None,
) -> None:
    """Delete a drive and its scans; it can be restored from the recycle bin.

    Revisions that were built from it stay.
    """
    drives = running.store.drives
    require_purge(caller, purge=purge)
    (drives.purge if purge else drives.delete)(map_slug, drive_slug)
    running.collector.wake()


@writing.put(
    "/maps/{map}/drives/{drive}/scans/{index}",
    openapi_extra=described_body(SCAN_TYPES),
    status_code=status.HTTP_201_CREATED,
    responses={
        201: headed(LOCATION),
        200: {"model": ScanOut, "description": "The same returns were stored already."},
        **problems(
            stored.MapNotFound,
            stored.InvalidSlug,
            stored.ScanConflict,
            stored.DriveClosed,
            InvalidParameters,
            InvalidPose,
            errors.InvalidRequest,
            *errors.BAD_SCAN,
            *errors.WRITING,
        ),
    },
)
@heavy
def put_scan(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    index: ScanIndex,
    body: Body,
    running: Running,
    response: Response,
    content_type: ContentType = None,
    timestamp_s: TimestampQuery = None,
    pose: PoseQuery = None,
) -> ScanOut:
    """Store one scan; the first scan of a drive creates the drive.

    The scan is on disk before the answer is sent. Safe to repeat: the same returns at the same
    index answer 200 and change nothing, others are rejected. A new scan's index is below 10^9.
    """
    scan = read_scan(
        body,
        media_type=content_type,
        min_returns=running.settings.min_returns,
        timestamp_s=nan_if_none(timestamp_s),
        pose=pose_from_query(pose),
    )
    result = running.store.drives.put_scan(map_slug, drive_slug, index, scan)
    if result.created:
        response.headers[LOCATION] = f"/v1/maps/{map_slug}/drives/{drive_slug}/scans/{index}"
    else:
        response.status_code = status.HTTP_200_OK
    return ScanOut.of_put(scan, result.record)


@scans.get(
    "/maps/{map}/drives/{drive}/scans/{index}",
    response_class=Response,
    responses={
        200: {
            "description": "`(n, 3)` float32 metres.",
            "content": {_NPY: {"schema": {"type": "string", "format": "binary"}}},
            **headed(CONTENT_DISPOSITION),
        },
        **problems(
            *_DRIVE,
            stored.ScanNotFound,
            stored.ReturnsGone,
            stored.CorruptFile,
            errors.InvalidRequest,
            *errors.READING,
        ),
    },
)
@heavy
def get_scan(
    map_slug: MapSlug, drive_slug: DriveSlug, index: ScanIndex, running: Running
) -> Response:
    """Return a scan's returns as a NumPy array file."""
    scan = running.store.drives.read_scan(map_slug, drive_slug, index)
    file = io.BytesIO()
    np.save(file, scan.points_m, allow_pickle=False)
    # Without a name for it, the pages of the API show a megabyte of numbers as text.
    name = f"{map_slug}-{drive_slug}-{index}.npy"
    headers = {CONTENT_DISPOSITION: f'attachment; filename="{name}"'}
    return Response(file.getvalue(), media_type=_NPY, headers=headers)
