"""Uploads: POST of many scans in one archive, and which scans are in."""

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Annotated

from fastapi import Query, Request
from starlette.requests import ClientDisconnect

from app.access.scopes import Scope, needs
from app.drives.many_scans import ScanUpload
from app.drives.upload_schemas import PresentOut, UploadOut
from app.http import errors
from app.http.bodies.bodies import AsItComes, ContentType, described_body, media_type
from app.http.bodies.incoming import Incoming
from app.http.bodies.spool import Spool
from app.http.context import context_of
from app.http.pooled_route import pooled_router, run_heavy
from app.http.problems import problems
from app.service import DriveSlug, MapSlug, Running
from core.errors import TensorMapError
from storage.errors import DriveNotFound, InvalidSlug, MapNotFound
from storage.formats.errors import UnknownFormat
from storage.formats.scans.registry import FORMAT_NAMES, media_type_of

router = pooled_router(tags=["drives"])

_TAR = "application/x-tar"
_BATCH_BYTES = 4 * 2**20
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
    responses=problems(MapNotFound, DriveNotFound, *errors.READING),
)
def list_scans(map_slug: MapSlug, drive_slug: DriveSlug, running: Running) -> PresentOut:
    """Tell which scans are in, as ranges: an upload goes on with the others."""
    return PresentOut.from_record(running.store.drives.get(map_slug, drive_slug))


@router.post(
    "/maps/{map}/drives/{drive}/scans",
    dependencies=[needs(Scope.MAPS_WRITE)],
    openapi_extra=described_body(
        {_TAR: "A tar stream of scan files, each named by its index, as `000012.pcd`."}
    ),
    responses=problems(
        MapNotFound,
        InvalidSlug,
        errors.InvalidRequest,
        errors.MalformedUpload,
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
    """Store many scans, sent as a tar stream; one that cannot be used stops none of the others.

    Scans are stored as they come, a few megabytes at a time. When the answer is there the scans
    that it names are on disk; when it is not, ask which are in and send the others, or all again.
    With a `Content-Digest` nothing is stored before the whole body has come and is what it says; a
    packed body is unpacked when it has come whole, or as far as it came.
    """
    if media_type(content_type) not in _TYPES:
        raise errors.UnsupportedBody(
            f"Content-Type is {(content_type or '')[:80]!r}, wanted {_TAR}"
        )
    wanted = None if format_name is None else media_type_of(format_name)
    # A missing map is reported before a body is read.
    await running.pools.short.run(
        context_of(request.scope).sender, partial(running.store.drives.slugs, map_slug)
    )
    upload = ScanUpload(
        running.store,
        map_slug,
        drive_slug,
        media_type=wanted,
        min_returns=running.settings.min_returns,
        most_bytes=running.settings.max_body_bytes,
        folder=running.settings.data_dir,
    )
    # An unpacker takes megabytes: none waits for the rest of a slow body.
    up_to = None if body.packed or body.has_digest else _BATCH_BYTES
    async with body.spool() as spool:
        while not body.ended:
            try:
                await body.fill(spool, up_to)
            except (TensorMapError, ClientDisconnect):
                if not body.has_digest:
                    await run_heavy(request, partial(_store_rest, upload, body, spool), begun=True)
                raise
            await _store(request, upload, body, spool)
    return await run_heavy(request, lambda: UploadOut.from_upload(upload.finish()), begun=True)


async def _store(request: Request, upload: ScanUpload, body: Incoming, spool: Spool) -> None:
    """Store what came, a batch after another: between two it is the turn of other keys."""
    pieces = body.unpacked(spool.pieces())
    more = True
    while more:
        more = await run_heavy(request, partial(_store_batch, upload, pieces), begun=True)
    spool.clear()


def _store_batch(upload: ScanUpload, pieces: Iterator[bytes]) -> bool:
    """Store what the next megabytes hold, and return whether there may be more."""
    taken = 0

    def batch() -> Iterator[bytes]:
        nonlocal taken
        for piece in pieces:
            taken += len(piece)
            yield piece
            if taken >= _BATCH_BYTES:
                return

    upload.take(batch())
    return taken >= _BATCH_BYTES


def _store_rest(upload: ScanUpload, body: Incoming, spool: Spool) -> None:
    """Store what came before the body was cut off."""
    with suppress(TensorMapError):  # of two faults the first one is reported
        upload.take(body.unpacked(spool.pieces()))
        upload.store()
