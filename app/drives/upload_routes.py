"""Uploads of a drive: many scans in one archive, and the stored indices."""

from functools import partial
from typing import Annotated

from fastapi import Query, Request

from app.access.api_router import api_router
from app.access.dependency import require_access_still
from app.access.scopes import Scope, needs
from app.drives.scan_upload import ScanUpload
from app.drives.schemas import PresentOut, UploadOut
from app.drives.upload_reception import store_as_received
from app.http import errors
from app.http.bodies.bodies import AsItComes, ContentType, described_body, required_type
from app.http.context import context_of
from app.http.problems import problems
from app.http.slugs import DriveSlug, MapSlug
from app.service import Running
from storage.errors import DriveNotFound, InvalidSlug, MapNotFound
from storage.formats.errors import UnknownFormat
from storage.formats.scans.registry import FORMAT_NAMES, media_type_of

reading = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_READ, Scope.MAPS_WRITE),))
writing = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_WRITE),))

_TAR = "application/x-tar"
_TYPES = (_TAR, "application/tar", "application/octet-stream", "")

FormatName = Annotated[
    str | None,
    Query(
        alias="format",
        description="Format of the files whose suffix says none, as `.bin`: the last word of a"
        " scan's media type, as `kitti`. Others have that of their suffixes.",
        json_schema_extra={"enum": list(FORMAT_NAMES)},  # any other is an unknown format
    ),
]


@reading.get(
    "/maps/{map}/drives/{drive}/scans",
    responses=problems(MapNotFound, DriveNotFound, *errors.READING),
)
def list_scans(map_slug: MapSlug, drive_slug: DriveSlug, running: Running) -> PresentOut:
    """Return which scans are stored, as ranges: an upload continues with the others."""
    record = running.store.drives.get(map_slug, drive_slug)
    return PresentOut.of(record, drive=record.slug)


@writing.post(
    "/maps/{map}/drives/{drive}/scans",
    openapi_extra=described_body(
        {_TAR: "A tar stream of scan files, each named by its index or time, as `000012.pcd`."}
    ),
    responses=problems(
        MapNotFound,
        DriveNotFound,
        InvalidSlug,
        errors.InvalidRequest,
        errors.MalformedUpload,
        errors.NothingStored,
        UnknownFormat,
        *errors.ANY_BODY,
        *errors.WRITING,
    ),
)
async def post_scans(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    request: Request,
    running: Running,
    body: AsItComes,
    content_type: ContentType = None,
    format_name: FormatName = None,
) -> UploadOut:
    """Store many scans, sent as a tar stream; the others are stored if one cannot be used.

    Scans are stored as they arrive, a few megabytes at a time. The scans that the answer names are
    on disk; without an answer, request which are stored and send the others, or send all again.
    With a `Content-Digest` nothing is stored before the whole body was received and its digest is
    right; a packed body is unpacked when it is complete, or as far as it was received.

    Files are named by their scan's index, or by its time, `1679000000.1.pcd` or nanoseconds since
    1970: then their index is the rank in order of time, and nothing is stored before the whole body
    was received, and other such uploads to the drive were stored. Of a folder of KITTI odometry the
    times, poses and calibration are used.
    """
    required_type(content_type, *_TYPES)
    scan_type = media_type_of(format_name)
    # A missing map is reported before a body is read.
    of_map = await running.pools.short.run(
        context_of(request.scope).sender, partial(running.store.maps.get, map_slug)
    )
    upload = ScanUpload(
        running.store,
        running.settings,
        map_slug,
        drive_slug,
        scan_type,
        require_sender=partial(require_access_still, request),
    )
    lock = running.timed_uploads.of(of_map.id, drive_slug)
    return await store_as_received(request, body, upload, lock)
