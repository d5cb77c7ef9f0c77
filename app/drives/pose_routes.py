"""Poses and times of a drive's scans."""

from typing import Annotated

import numpy as np
from fastapi import Query

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.drives.pose_files import CSV, MOST_LINES, POSE_TYPES, read_poses, require_rising
from app.drives.pose_schemas import PosesIn, PosesOut
from app.drives.schemas import MOST_JUMPS, DriveOut, DriveWithPosesOut, PosesPutOut
from app.http import errors
from app.http.bodies.bodies import Body, ContentType, described_body, required_type
from app.http.bodies.json_body import read_json
from app.http.exact_types import QueryFlag
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.http.slugs import DriveSlug, MapSlug
from app.service import Running
from core.errors import InvalidParameters, InvalidPose
from core.scans.pose_steps import jumps
from core.scans.trajectory import SCAN_INDEX_LIMIT
from storage.errors import (
    DriveNotFound,
    InvalidSlug,
    MapNotFound,
    PosesDoNotFit,
    ReturnsGone,
    ScanNotFound,
)

reading = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_READ),))
writing = api_router(tags=["drives"], dependencies=(needs(Scope.MAPS_WRITE),))

_JSON = "application/json"
_AROUND = 10  # scans beside those that were put: their steps show what is usual

First = Annotated[
    int,
    Query(ge=0, lt=2**52, description="The scan of the first line, of KITTI's and TUM's files."),
]
FirstShown = Annotated[
    int, Query(alias="first", ge=0, lt=SCAN_INDEX_LIMIT, description="The first scan.")
]
Limit = Annotated[int, Query(ge=1, le=10_000, description="How many scans, at most.")]
Partial = Annotated[
    QueryFlag | None,
    Query(
        description="Set a file's poses even if their number, or scans that would lose theirs, show"
        " that they are not those of all scans."
    ),
]


@reading.get(
    "/maps/{map}/drives/{drive}/poses",
    responses=problems(MapNotFound, DriveNotFound, errors.InvalidRequest, *errors.READING),
)
@heavy
def get_poses(
    map_slug: MapSlug,
    drive_slug: DriveSlug,
    running: Running,
    first: FirstShown = 0,
    limit: Limit = 1000,
) -> PosesOut:
    """Return poses and timestamps of stored scans, in the order of their indices.

    `poses` of the answer can be put back as it is.
    """
    drives = running.store.drives
    drive = drives.get(map_slug, drive_slug)
    return PosesOut.from_core(drive, drives.poses(drive.id, first, limit + 1), limit)


@writing.put(
    "/maps/{map}/drives/{drive}/poses",
    openapi_extra=described_body(POSE_TYPES, PosesIn),
    responses=problems(
        MapNotFound,
        DriveNotFound,
        InvalidSlug,
        ScanNotFound,
        PosesDoNotFit,
        ReturnsGone,
        InvalidParameters,
        InvalidPose,
        *errors.JSON_BODY,
        *errors.WRITING,
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

    JSON sets those of the stored scans that it names. Times must not decrease from one scan of a
    request to the next. A file also sets what a scan that is stored
    later does not have itself, and is rejected if it ends before or behind the drive's last scan:
    it is another drive's, or cut off. Before the first scan it may have any number of lines.

    Known poses take the place of all that odometry computed. If returns of the drive were dropped,
    they have to be of all scans that have computed ones, and those of a drive of which several
    scans become one cannot change.
    """
    kind = required_type(content_type, _JSON, *POSE_TYPES)
    if first and kind in {_JSON, CSV}:
        raise InvalidParameters(
            f"first is {first}, and poses in JSON and in a table name their scans: send no first"
        )
    drives = running.store.drives
    if kind in POSE_TYPES:
        sent = read_poses(body, kind, first)
        scans = sent.scans
        put = drives.expect_poses(map_slug, drive_slug, sent, partial=bool(partial))
    else:
        poses, timestamps_s = read_json(body, PosesIn).to_core()
        timed = sorted(timestamps_s)
        require_rising(np.array(timed), np.array([timestamps_s[scan] for scan in timed]))
        scans = np.array(sorted({*poses, *timestamps_s}) or [0])
        put = drives.put_poses(map_slug, drive_slug, poses, timestamps_s)
    record = drives.get(map_slug, drive_slug)
    begin, end = max(0, int(scans[0]) - _AROUND), int(scans[-1]) + _AROUND
    around = drives.poses(record.id, begin, min(end - begin, MOST_LINES))
    around = around.only(around.scans <= end)
    return DriveWithPosesOut(
        **dict(DriveOut.from_record(record)),
        poses=PosesPutOut.of(put),
        jumps=jumps(around.scans, around.timestamps_s, around.poses).tolist()[:MOST_JUMPS],
    )
