"""Tracks: a vehicle's observations, one after another."""

from http import HTTPStatus
from typing import Annotated

from fastapi import Path, Query, Response

from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.drives.routes import BAD_SCAN
from app.http import errors
from app.http.bodies.bodies import SCAN_TYPES, Body, ContentType, described_body, media_type
from app.http.pooled_route import pooled_router
from app.http.problems import problems
from app.localization.routes import (
    IMAGE_TYPE,
    SIGNATURE_TYPE,
    SIGNATURE_TYPES,
    SensorHeight,
    read_image,
    read_signatures,
)
from app.localization.schemas import SignaturesIn
from app.service import MapSlug, Running, Service
from app.tracking.schemas import TrackOut, TrackStepOut
from app.tracking.tracks import LiveTrack
from core import errors as core
from core.encodings.signature import Signature
from core.localization.localizer import Localizer
from core.tracking.track import Observation
from storage import errors as stored
from storage.formats.errors import EmptyBody
from storage.formats.scans.registry import read_scan

router = pooled_router(tags=["tracks"], prefix="/maps/{map}/tracks")

TrackId = Annotated[str, Path(alias="track", description="The track's name.")]

_OBSERVATION_TYPES = {
    **SCAN_TYPES,
    **SIGNATURE_TYPES,
    IMAGE_TYPE: "An image on the map's grid, as localizations take it.",
}


@router.post(
    "",
    dependencies=[needs(Scope.LOCALIZE)],
    status_code=HTTPStatus.CREATED,
    responses=problems(
        *errors.REVISION,
        errors.TooManyTracks,
        errors.TooManyTracksOfKey,
        errors.InvalidRequest,
        *errors.READING,
    ),
)
def create_track(
    map_slug: MapSlug,
    running: Running,
    caller: CurrentCaller,
    response: Response,
    revision: Annotated[
        str | None,
        Query(
            pattern="^[0-9a-f]{12,64}$", description="Pin this revision; the live one without it."
        ),
    ] = None,
) -> TrackOut:
    """Begin a track. It stays in one revision, whatever becomes live, until it is idle.

    Where as many are kept as may be, a key that has less than its share takes the room of a track
    of the key that has most: the one that was idle for longest is no longer there.
    """
    answering = (
        running.revisions.live(map_slug)
        if revision is None
        else running.revisions.named(map_slug, revision)
    )
    record = running.store.maps.get(map_slug)
    created = running.tracks.create(record.id, caller.key_id, answering.localizer)
    response.headers["Location"] = f"/v1/maps/{map_slug}/tracks/{created.id}"
    return TrackOut.from_track(created, map_slug, answering.live_revision, running.tracks.idle_s)


@router.get(
    "/{track}",
    dependencies=[needs(Scope.LOCALIZE)],
    responses=problems(stored.MapNotFound, errors.TrackNotFound, *errors.READING),
)
def get_track(map_slug: MapSlug, track_id: TrackId, running: Running) -> TrackOut:
    """Show a track and its last answer."""
    found, live = track_of(running, map_slug, track_id)
    return TrackOut.from_track(found, map_slug, live, running.tracks.idle_s)


@router.delete(
    "/{track}",
    dependencies=[needs(Scope.LOCALIZE)],
    status_code=HTTPStatus.NO_CONTENT,
    responses=problems(stored.MapNotFound, errors.TrackNotFound, *errors.READING),
)
def delete_track(map_slug: MapSlug, track_id: TrackId, running: Running) -> None:
    """End a track."""
    found, _ = track_of(running, map_slug, track_id)
    running.tracks.delete(found.map_id, found.id)


@router.post(
    "/{track}/observations",
    dependencies=[needs(Scope.LOCALIZE)],
    openapi_extra=described_body(_OBSERVATION_TYPES, SignaturesIn),
    responses=problems(
        stored.MapNotFound,
        errors.TrackNotFound,
        core.StaleObservation,
        core.StaleSignature,
        core.UnknownSegment,
        core.InvalidSignature,
        core.InvalidImage,
        core.InvalidParameters,
        errors.InvalidRequest,
        core.SensorMismatch,
        EmptyBody,
        *errors.ANY_BODY,
        *BAD_SCAN,
        *errors.READING,
    ),
)
def observe(
    map_slug: MapSlug,
    track_id: TrackId,
    body: Body,
    running: Running,
    content_type: ContentType = None,
    timestamp_s: Annotated[
        float | None,
        Query(allow_inf_nan=False, description="By the vehicle's own clock; rises in a track."),
    ] = None,
    sequence: Annotated[
        int | None, Query(ge=0, lt=2**53, description="The observation's number; rises.")
    ] = None,
    travelled_m: Annotated[
        float | None,
        Query(
            allow_inf_nan=False,
            description="Odometry since the last observation, negative backwards.",
        ),
    ] = None,
    sensor_height_m: SensorHeight = None,
) -> TrackStepOut:
    """Take the next observation: a scan, an image or signatures."""
    found, live = track_of(running, map_slug, track_id)
    localizer = found.track.localizer
    signatures = _signatures(localizer, body, content_type, running, sensor_height_m)
    observation = Observation(signatures, timestamp_s, sequence, travelled_m)
    step = found.observe(observation)
    running.metrics.localized("track", step.reason)
    return TrackStepOut.from_core(found.id, step, live)


def track_of(running: Service, map_slug: str, track_id: str) -> tuple[LiveTrack, str | None]:
    """Return a track, and the live revision of its map.

    Raises:
        MapNotFound: If there is no such map.
        TrackNotFound: If the map has no such track, or no longer.
    """
    record = running.store.maps.get(map_slug)
    return running.tracks.get(record.id, track_id), record.live_revision


def _signatures(
    localizer: Localizer,
    body: bytes,
    content_type: str | None,
    running: Service,
    sensor_height_m: float | None,
) -> tuple[Signature, ...]:
    kind = media_type(content_type)
    if kind in {"application/json", SIGNATURE_TYPE}:
        return read_signatures(body, content_type)
    if kind == IMAGE_TYPE:
        return localizer.basis.encode(read_image(body, localizer.map.parameters.grid))
    scan = read_scan(body, media_type=content_type, min_returns=running.settings.min_returns)
    return localizer.basis.encode(localizer.basis.image(scan, sensor_height_m))
