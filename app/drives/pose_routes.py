"""Poses of a drive's scans, as JSON or as files."""

from typing import Annotated

from fastapi import Query

from app.access.scopes import Scope, needs
from app.drives.pose_files import CSV, POSE_TYPES, read_poses
from app.drives.pose_schemas import PosesIn
from app.drives.schemas import DriveWithPosesOut
from app.http.bodies.bodies import Body, ContentType, described_body, media_type
from app.http.bodies.json_body import read_json
from app.http.errors import JSON_BODY, WRITING, UnsupportedBody
from app.http.pooled_route import pooled_router
from app.http.problems import problems
from app.service import DriveSlug, MapSlug, Running
from core.errors import InvalidPose
from storage import errors as stored

router = pooled_router(tags=["drives"])

_JSON = "application/json"

First = Annotated[
    int,
    Query(ge=0, lt=2**52, description="The scan of the first line, of KITTI's and TUM's files."),
]
Partial = Annotated[
    bool | None,
    Query(
        description="Set a file's poses even if their number, or scans that would lose theirs, show"
        " that they are not those of all scans."
    ),
]


@router.put(
    "/maps/{map}/drives/{drive}/poses",
    dependencies=[needs(Scope.MAPS_WRITE)],
    openapi_extra=described_body(POSE_TYPES, PosesIn),
    responses=problems(
        stored.MapNotFound,
        stored.DriveNotFound,
        stored.InvalidSlug,
        stored.ScanNotFound,
        stored.PosesDoNotFit,
        InvalidPose,
        *JSON_BODY,
        *WRITING,
    ),
)
def put_poses(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    body: Body,
    running: Running,
    content_type: ContentType = None,
    first: First = 0,
    partial: Partial = None,
) -> DriveWithPosesOut:
    """Set poses and timestamps of scans, all or none; those of a file also for future scans.

    JSON sets those of stored scans only. A file also sets what a scan that is stored later does not
    have itself. A file whose lines count scans is rejected if it has fewer than the drive has
    scans, or if it has more and would replace other poses: it is another drive's, or cut off.
    """
    kind = media_type(content_type)
    drives = running.store.drives
    if kind in POSE_TYPES:
        put = drives.expect_poses(
            map_slug,
            drive_slug,
            read_poses(body, kind, first),
            consecutive=kind != CSV,
            partial=bool(partial),
        )
    elif kind == _JSON:
        poses, timestamps_s = read_json(body, PosesIn).to_core()
        put = drives.put_poses(map_slug, drive_slug, poses, timestamps_s)
    else:
        known = ", ".join((_JSON, *POSE_TYPES))
        raise UnsupportedBody(f"Content-Type is {kind[:80]!r}, wanted one of {known}")
    return DriveWithPosesOut.from_both(drives.get(map_slug, drive_slug), put)
