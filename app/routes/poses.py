"""Poses of a drive's scans, as JSON or as files have them."""

from typing import Annotated

from fastapi import Query

from app.access.scopes import Scope, needs
from app.bodies.bodies import Body, ContentType, binary_body, media_type
from app.bodies.json_body import read_json
from app.errors import JSON_BODY, WRITING, UnsupportedBody
from app.pooled_route import pooled_router
from app.problems import problems
from app.schemas.drives import DriveOut
from app.schemas.poses import PosesIn
from app.service import DriveSlug, MapSlug, Running
from app.uploads.pose_files import POSE_TYPES, read_poses
from core.errors import InvalidPose
from storage.errors import DriveNotFound, InvalidSlug, MapNotFound, ScanNotFound

__all__ = ["router"]

router = pooled_router(tags=["drives"])

_JSON = "application/json"

First = Annotated[
    int,
    Query(ge=0, lt=2**52, description="The scan of the first line, of KITTI's and TUM's files."),
]


@router.put(
    "/maps/{map}/drives/{drive}/poses",
    dependencies=[needs(Scope.MAPS_WRITE)],
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                _JSON: {"schema": {"$ref": "#/components/schemas/PosesIn"}},
                **binary_body(**POSE_TYPES)["requestBody"]["content"],
            },
        }
    },
    responses=problems(
        MapNotFound, DriveNotFound, InvalidSlug, ScanNotFound, InvalidPose, *JSON_BODY, *WRITING
    ),
)
def put_poses(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    body: Body,
    running: Running,
    content_type: ContentType = None,
    first: First = 0,
) -> DriveOut:
    """Set poses and timestamps of scans, all or none; those of a file also of scans to come.

    As JSON, of scans that are stored only. From a file, what a scan to come has not of its own.
    """
    kind = media_type(content_type)
    drives = running.store.drives
    if kind in POSE_TYPES:
        found = read_poses(body, kind, first)
        drives.expect_poses(map_slug, drive_slug, found.poses, found.timestamps_s)
    elif kind == _JSON:
        poses, timestamps_s = read_json(body, PosesIn).to_core()
        drives.put_poses(map_slug, drive_slug, poses, timestamps_s)
    else:
        wanted = ", ".join((_JSON, *POSE_TYPES))
        raise UnsupportedBody(f"Content-Type is {kind[:80]!r}, wanted one of {wanted}")
    return DriveOut.from_record(drives.get(map_slug, drive_slug))
