"""Captures in parts: begin one, send its parts in any order, complete it, and follow its job."""

from typing import Annotated

from fastapi import Path, Response, status
from pydantic import BeforeValidator

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.captures.recording import require_readable
from app.captures.schemas import (
    SMALLEST_PART_BYTES,
    CaptureIn,
    CaptureOut,
    CapturePatch,
    CaptureSummaryOut,
)
from app.http import errors
from app.http.answer_headers import LOCATION, headed
from app.http.bodies.bodies import (
    LARGEST_PART_BYTES,
    Body,
    ContentType,
    Json,
    described_body,
    required_type,
)
from app.http.exact_types import in_digits
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.http.slugs import DriveSlug, MapSlug
from app.service import Running, Service
from core.errors import InvalidParameters
from storage import errors as stored
from storage.catalog import CaptureRecord, NewCapture
from storage.formats.errors import MalformedDrive, UnknownDriveLayout

reading = api_router(tags=["captures"], dependencies=(needs(Scope.MAPS_READ, Scope.MAPS_WRITE),))
writing = api_router(tags=["captures"], dependencies=(needs(Scope.MAPS_WRITE),))

_CAPTURE = (stored.MapNotFound, stored.CaptureNotFound)
_TYPES = ("application/octet-stream", "")
_USUAL_PARTS, _MOST_PARTS = 200, 10_000

CaptureId = Annotated[str, Path(alias="capture", max_length=64, description="The capture's id.")]
PartNumber = Annotated[
    int,
    Path(alias="part", ge=0, lt=2**31, description="The part's number, from 0."),
    BeforeValidator(in_digits),
]


@writing.post(
    "/maps/{map}/drives/{drive}/captures",
    status_code=status.HTTP_201_CREATED,
    responses={
        201: headed(LOCATION),
        200: {"model": CaptureOut, "description": "It was begun before, with the same `sha256`."},
        **problems(
            stored.MapNotFound,
            stored.InvalidSlug,
            stored.DriveClosed,
            stored.TooManyCaptures,
            errors.CaptureTooLarge,
            InvalidParameters,
            UnknownDriveLayout,
            MalformedDrive,
            *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
)
def begin_capture(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    sent: Json[CaptureIn],
    running: Running,
    caller: CurrentCaller,
    response: Response,
) -> CaptureOut:
    """Begin to upload a capture or bag in parts; then send the parts that are `missing`.

    Its scans get the drive's indices from `first_scan` on. With `sha256`, an upload whose id was
    lost is continued by the same request.
    """
    files = tuple((file.name, file.size_bytes) for file in sent.files)
    require_readable([name for name, _ in files], sent.topic)
    size_bytes = sum(size for _, size in files)
    most = running.settings.max_upload_bytes
    if size_bytes > most:
        raise errors.CaptureTooLarge(f"the capture has {size_bytes} bytes, at most {most} are read")
    part_bytes = _part_bytes(size_bytes, sent.part_bytes, running.settings.max_body_bytes)
    note(f"{files[0][0]} of {len(files)} files, {size_bytes} bytes")
    new = NewCapture(
        drive_slug,
        files,
        part_bytes,
        topic=sent.topic,
        first_scan=sent.first_scan,
        digest=sent.sha256,
        key_id=caller.key_id,
    )
    capture, is_new = running.store.captures.create(
        map_slug, new, running.settings.max_capture_bytes_per_key
    )
    if is_new:
        response.headers[LOCATION] = (
            f"/v1/maps/{map_slug}/drives/{drive_slug}/captures/{capture.id}"
        )
    else:
        response.status_code = status.HTTP_200_OK
    return _out(running, capture)


@reading.get(
    "/maps/{map}/captures",
    responses=problems(
        stored.MapNotFound, InvalidParameters, errors.InvalidRequest, *errors.READING
    ),
)
@heavy
def list_captures(
    map_slug: MapSlug, running: Running, after: After = "", limit: Limit = 100
) -> PageOut[CaptureSummaryOut]:
    """List the captures that are uploaded for drives of a map, newest first."""
    page = running.store.captures.list(map_slug, None, after, limit)
    kept_hours = running.settings.capture_hours
    return page_out(page, lambda capture: CaptureSummaryOut.from_record(capture, kept_hours))


@reading.get(
    "/maps/{map}/drives/{drive}/captures",
    responses=problems(
        stored.MapNotFound,
        stored.InvalidSlug,
        InvalidParameters,
        errors.InvalidRequest,
        *errors.READING,
    ),
)
@heavy
def list_captures_of_drive(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    running: Running,
    after: After = "",
    limit: Limit = 100,
) -> PageOut[CaptureSummaryOut]:
    """List the captures that are uploaded for a drive, newest first; it may not exist yet."""
    page = running.store.captures.list(map_slug, drive_slug, after, limit)
    kept_hours = running.settings.capture_hours
    return page_out(page, lambda capture: CaptureSummaryOut.from_record(capture, kept_hours))


@reading.get(
    "/maps/{map}/drives/{drive}/captures/{capture}",
    responses=problems(*_CAPTURE, errors.InvalidRequest, *errors.READING),
)
def get_capture(
    map_slug: MapSlug, drive_slug: DriveSlug, capture_id: CaptureId, running: Running
) -> CaptureOut:
    """Show a capture: which parts are stored, which are missing, and what became of it."""
    return _out(running, running.store.captures.get(map_slug, drive_slug, capture_id))


@writing.put(
    "/maps/{map}/drives/{drive}/captures/{capture}/parts/{part}",
    openapi_extra=described_body({_TYPES[0]: "The bytes of the part."}),
    status_code=status.HTTP_201_CREATED,
    responses={
        200: {"model": CaptureOut, "description": "The same bytes were stored already."},
        **problems(
            *_CAPTURE,
            stored.PartConflict,
            stored.CaptureQueued,
            stored.PartDoesNotFit,
            errors.InvalidRequest,
            *errors.ANY_BODY,
            *errors.WRITING,
        ),
    },
)
@heavy
def put_part(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    capture_id: CaptureId,
    part: PartNumber,
    body: Body,
    running: Running,
    response: Response,
    content_type: ContentType = None,
) -> CaptureOut:
    """Store a part, in any order; it is on disk before the answer is sent.

    Part `n` begins at byte `n * part_bytes`. The same bytes again answer 200 and change nothing,
    others are rejected. With a `Content-Digest` a part that was changed on its way is rejected.
    """
    required_type(content_type, *_TYPES)
    capture, is_new = running.store.captures.put_part(map_slug, drive_slug, capture_id, part, body)
    if not is_new:
        response.status_code = status.HTTP_200_OK
    return _out(running, capture)


@writing.patch(
    "/maps/{map}/drives/{drive}/captures/{capture}",
    status_code=status.HTTP_202_ACCEPTED,
    responses={
        202: headed(sometimes=(LOCATION,)),
        **problems(
            *_CAPTURE,
            stored.PartsMissing,
            stored.CaptureQueued,
            stored.TooManyBuilds,
            UnknownDriveLayout,
            MalformedDrive,
            *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
)
def complete_capture(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    capture_id: CaptureId,
    change: Json[CapturePatch],
    running: Running,
    caller: CurrentCaller,
    response: Response,
) -> CaptureOut:
    """Queue a job that reads a capture whose parts are all stored; follow it at `Location`.

    The job runs in a process with limits, and its parts are deleted when it is done. One that
    failed or was cancelled can be queued again, a bag with another topic, but not while its job is
    being cancelled; one that is queued, read or done stays as it is.
    """
    if change.topic is not None:
        begun = running.store.captures.get(map_slug, drive_slug, capture_id)
        require_readable([name for name, _ in begun.files], change.topic)
    capture = running.store.captures.complete(
        map_slug,
        drive_slug,
        capture_id,
        topic=change.topic,
        key_id=caller.key_id,
        most_queued=running.settings.max_queued_builds_per_key,
    )
    running.runner.wake()
    if capture.job is not None:
        response.headers[LOCATION] = f"/v1/jobs/{capture.job.id}"
    return _out(running, capture)


@writing.delete(
    "/maps/{map}/drives/{drive}/captures/{capture}",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(*_CAPTURE, errors.InvalidRequest, *errors.WRITING),
)
@heavy
def delete_capture(
    map_slug: MapSlug, drive_slug: DriveSlug, capture_id: CaptureId, running: Running
) -> None:
    """Delete a capture with its parts, and cancel its job; scans that were stored stay."""
    running.store.captures.delete(map_slug, drive_slug, capture_id)


def _out(running: Service, capture: CaptureRecord) -> CaptureOut:
    return CaptureOut.from_record(capture, running.settings.capture_hours)


def _part_bytes(size_bytes: int, wanted: int | None, most_body_bytes: int) -> int:
    """Return the size of the parts of a capture.

    Raises:
        InvalidParameters: If `wanted` is more than a body may have.
        CaptureTooLarge: If it would have too many parts.
    """
    most = min(LARGEST_PART_BYTES, most_body_bytes)
    if wanted is not None and wanted > most:
        raise InvalidParameters(f"part_bytes is {wanted}, bodies may have {most} here")
    usual = -(-size_bytes // _USUAL_PARTS // SMALLEST_PART_BYTES) * SMALLEST_PART_BYTES
    part_bytes = wanted or min(max(usual, SMALLEST_PART_BYTES), most)
    if size_bytes > part_bytes * _MOST_PARTS:
        raise errors.CaptureTooLarge(
            f"the capture has {size_bytes} bytes, at most {_MOST_PARTS} parts of {part_bytes} are"
            f" taken{': use larger parts' if part_bytes < most else ''}"
        )
    return part_bytes
