"""Uploads: many scans in one body, and which of them are in."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

from fastapi import APIRouter, Query, Request

from app.access.scopes import Scope, needs
from app.bodies.bodies import ContentType, binary_body, media_type
from app.errors import (
    ANY_BODY,
    READING,
    WRITING,
    InvalidRequest,
    MalformedUpload,
    UnsupportedBody,
)
from app.problems import problems
from app.schemas.uploads import PresentOut, UploadOut
from app.service import DriveSlug, MapSlug, Running
from app.uploads.many_scans import BodyReader, spooled, store_scans
from app.uploads.tar_stream import TarStream
from storage.errors import DriveNotFound, InvalidSlug, MapNotFound
from storage.formats.errors import UnknownFormat
from storage.formats.registry import FORMAT_NAMES, media_type_of

__all__ = ["router"]

router = APIRouter(tags=["drives"])

_TAR = "application/x-tar"
_TYPES = {"", "application/octet-stream", _TAR, "application/tar"}

FormatName = Annotated[
    str | None,
    Query(
        alias="format",
        description="What the files are, the last word of a scan's media type, as `kitti`; without"
        " it their suffixes tell, but for `.bin`.",
        json_schema_extra={"enum": list(FORMAT_NAMES)},  # what is none is an unknown format
    ),
]


@router.get(
    "/maps/{map}/drives/{drive}/scans",
    dependencies=[needs(Scope.MAPS_READ, Scope.MAPS_WRITE)],
    responses=problems(MapNotFound, DriveNotFound, *READING),
)
def list_scans(map_slug: MapSlug, drive_slug: DriveSlug, running: Running) -> PresentOut:
    """Tell which scans are in, as ranges: an upload goes on with the others."""
    return PresentOut.from_record(running.store.drives.get(map_slug, drive_slug))


@router.post(
    "/maps/{map}/drives/{drive}/scans",
    dependencies=[needs(Scope.MAPS_WRITE)],
    openapi_extra=binary_body(
        **{_TAR: "A tar stream of scan files, each named by its index, as `000012.pcd`."}
    ),
    responses=problems(
        MapNotFound,
        InvalidSlug,
        InvalidRequest,
        MalformedUpload,
        UnknownFormat,
        *ANY_BODY,
        *WRITING,
    ),
)
def post_scans(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    request: Request,
    running: Running,
    content_type: ContentType = None,
    format_name: FormatName = None,
) -> UploadOut:
    """Store many scans, sent as a tar stream; one that cannot be used stops none of the others.

    Scans are stored as they come, a few megabytes at a time. When the answer is there the scans
    that it names are on disk; when it is not, ask which are in and send the others, or all again.
    With a `Content-Digest` nothing is stored before the whole body has come and is what it says.
    """
    if media_type(content_type) not in _TYPES:
        raise UnsupportedBody(f"Content-Type is {(content_type or '')[:80]!r}, wanted {_TAR}")
    wanted = None if format_name is None else media_type_of(format_name)
    running.store.drives.slugs(map_slug)  # a map that is not there is told before a body is read
    with _read_from(request, running) as archive:
        return UploadOut.from_upload(
            store_scans(
                running.store,
                map_slug,
                drive_slug,
                archive,
                media_type=wanted,
                min_returns=running.settings.min_returns,
            )
        )


@contextmanager
def _read_from(request: Request, running: Running) -> Iterator[TarStream]:
    """Give the body as an archive: as it comes, or checked first if it has a digest."""
    read = BodyReader(request.stream())
    most_bytes = running.settings.max_body_bytes
    if request.headers.get("content-digest", "").strip():
        with spooled(read, str(running.settings.data_dir)) as file:
            yield TarStream(file.read, most_bytes)
    else:
        yield TarStream(read, most_bytes)
