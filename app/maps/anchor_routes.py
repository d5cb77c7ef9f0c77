"""The anchor of a map, fitted to the track of a GNSS receiver."""

from fastapi import Response

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.http import errors
from app.http.answer_headers import ETAG, headed
from app.http.bodies.bodies import Json
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.maps.anchor_schemas import GnssTrackIn
from app.maps.schemas import MapOut
from app.maps.versions import IfMatch, shown_map, versions_seen
from app.service import Running
from core.errors import AnchorDoesNotFit, UnknownDrive
from core.frames.gnss import fit_anchor
from storage.errors import MapChanged

router = api_router(tags=["maps"], dependencies=(needs(Scope.MAPS_WRITE),))


@router.post(
    "/maps/{map}/anchor",
    responses={
        200: headed(ETAG),
        **problems(
            *errors.REVISION,
            MapChanged,
            UnknownDrive,
            AnchorDoesNotFit,
            *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
)
@heavy
def fit_map_anchor(
    map_slug: MapSlug,
    sent: Json[GnssTrackIn],
    running: Running,
    response: Response,
    if_match: IfMatch = None,
) -> MapOut:
    """Fit the map's anchor to the track of a GNSS receiver on one of its drives, and set it.

    The drive's positions in the live revision are interpolated at the times of the fixes. The
    origin and heading on which most of these agree are fitted to them; nothing is scaled. A track
    that does not fit, or is too short for a heading to a degree, is rejected with the figures.
    """
    answering = running.revisions.get(map_slug, None)
    trajectory = answering.localizer.map.trajectory
    if sent.drive not in trajectory.drives:
        raise UnknownDrive(
            f"the live revision has no drive {sent.drive!r}, it has {', '.join(trajectory.drives)}"
        )
    if sent.drive in answering.localizer.map.drives_aside:
        raise AnchorDoesNotFit(
            f"drive {sent.drive} lies beside the others, which it does not meet: it has no place in"
            " the map; take another drive"
        )
    rows = trajectory.rows_of(sent.drive)
    anchor = fit_anchor(
        sent.drive,
        trajectory.timestamp_s[rows],
        trajectory.poses[rows, :3],
        sent.to_core(),
    )
    note(f"anchor {anchor}")
    record = running.store.maps.update(
        map_slug,
        anchor=anchor,
        if_versions=versions_seen(if_match),
        if_live=answering.live_revision,  # another one may have another frame
    )
    return shown_map(record, running, response)
