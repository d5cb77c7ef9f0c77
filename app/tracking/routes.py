"""Tracks: the observations of a vehicle, one at a time."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from typing import Annotated

from fastapi import Path, Query, Response

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.http import errors
from app.http.answer_forms import Accept
from app.http.answer_headers import LOCATION, headed
from app.http.bodies.bodies import Body, ContentType, described_body, media_type
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import light, quick
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.localization.limited_queries import require_measured
from app.localization.query_bodies import (
    IMAGE_TYPE,
    SIGNATURE_TYPE,
    SIGNATURE_TYPES,
    read_image,
    read_signatures,
)
from app.localization.scan_queries import BAD_SCAN_QUERY, SCAN_QUERY_TYPES, read_query
from app.localization.sensor_schemas import SensorIn
from app.localization.signature_schemas import SignaturesIn
from app.service import Running, Service
from app.tracking.answers import STEP, StepAnswer, form_of
from app.tracking.live_track import LiveTrack, TrackUnloaded
from app.tracking.schemas import ObservationQuery, TrackListed, TrackOut, TrackStepOut
from app.tracking.stream_messages import OBSERVATION_LAYOUT
from core import errors as core
from core.encodings.signature import Signature
from core.localization.localizer import Localizer
from core.mapping.georeference import Georeference
from core.projection.imager import Image
from core.tracking.track import Observation
from storage import errors as stored
from storage.formats.errors import EmptyBody
from storage.names import PREFIX_PATTERN

router = api_router(
    tags=["tracks"], prefix="/maps/{map}/tracks", dependencies=(needs(Scope.LOCALIZE),)
)

TrackId = Annotated[str, Path(alias="track", description="The track's name.")]

_OBSERVATION_TYPES = {
    **SCAN_QUERY_TYPES,
    **SIGNATURE_TYPES,
    IMAGE_TYPE: "An image on the map's grid, as localizations take it.",
}


@router.post(
    "",
    status_code=HTTPStatus.CREATED,
    responses={
        201: headed(LOCATION),
        **problems(
            *errors.REVISION,
            errors.TooManyTracks,
            errors.TooManyTracksOfKey,
            errors.InvalidRequest,
            *errors.WRITING,
        ),
    },
)
def create_track(
    map_slug: MapSlug,
    running: Running,
    caller: CurrentCaller,
    response: Response,
    revision: Annotated[
        str | None,
        Query(
            pattern=f"^{PREFIX_PATTERN}$", description="Pin this revision; the live one without it."
        ),
    ] = None,
) -> TrackOut:
    """Create a track. It stays in one revision, whatever becomes live, until it is idle.

    At the limit of all tracks, a key with less than its share replaces the track of the key with
    the most that was idle for longest.
    """
    answering = running.revisions.get(map_slug, revision)
    record = running.store.maps.get(map_slug)
    created = running.tracks.create(record.id, caller.key_id, answering.localizer)
    response.headers[LOCATION] = f"/v1/maps/{map_slug}/tracks/{created.id}"
    return TrackOut.from_track(created, map_slug, answering.live_revision, running.tracks.idle_s)


@router.get(
    "",
    responses=problems(
        stored.MapNotFound, core.InvalidParameters, errors.InvalidRequest, *errors.READING
    ),
)
def list_tracks(
    map_slug: MapSlug,
    running: Running,
    caller: CurrentCaller,
    after: After = "",
    limit: Limit = 100,
) -> PageOut[TrackListed]:
    """List the tracks of a map in the order of their names: those of the caller's key.

    A key with scope `admin` lists the tracks of all keys. Who has a track's name can go on with it.
    """
    record = running.store.maps.get(map_slug)
    key_id = None if caller.may(Scope.ADMIN) else caller.key_id
    page = running.tracks.page(record.id, after, limit, key_id)
    return page_out(page, partial(TrackListed.from_saved, anchor=record.anchor))


@router.get(
    "/{track}",
    responses=problems(errors.TrackNotFound, *errors.REVISION, *errors.READING),
)
@light
def get_track(map_slug: MapSlug, track_id: TrackId, running: Running) -> TrackOut:
    """Return a track and its last answer."""
    found, live, georeference = track_of(running, map_slug, track_id)
    return TrackOut.from_track(found, map_slug, live, running.tracks.idle_s, georeference)


@router.delete(
    "/{track}",
    status_code=HTTPStatus.NO_CONTENT,
    responses=problems(stored.MapNotFound, errors.TrackNotFound, *errors.WRITING),
)
@light
def delete_track(map_slug: MapSlug, track_id: TrackId, running: Running) -> None:
    """Remove a track."""
    running.tracks.delete(running.store.maps.get(map_slug).id, track_id)


@router.post(
    "/{track}/observations",
    response_model=TrackStepOut,
    openapi_extra=described_body(_OBSERVATION_TYPES, SignaturesIn),
    responses=STEP.responses("TrackStepOut")
    | problems(
        *errors.REVISION,
        errors.TrackNotFound,
        core.StaleObservation,
        core.StaleSignature,
        core.UnknownSegment,
        core.InvalidSignature,
        core.InvalidImage,
        errors.InvalidRequest,
        core.SensorMismatch,
        EmptyBody,
        *errors.ANY_BODY,
        *BAD_SCAN_QUERY,
        *errors.READING,
    ),
)
@quick
def observe(
    map_slug: MapSlug,
    track_id: TrackId,
    body: Body,
    running: Running,
    query: Annotated[ObservationQuery, Query()],
    content_type: ContentType = None,
    accept: Accept = None,
) -> TrackStepOut | Response:
    """Take the next observation: a scan, several that become one, an image or signatures."""
    form = form_of(query.fields, accept)

    def observation_for(localizer: Localizer) -> Observation:
        return query.to_core(*_signatures_and_image(localizer, body, content_type, running, query))

    answer = take_observation(running, map_slug, track_id, observation_for)
    return form.response(answer.shown, answer.packed)


def take_observation(
    running: Service,
    map_slug: str,
    track_id: str,
    observation_for: Callable[[Localizer], Observation],
) -> StepAnswer:
    """Take a track's next observation, which may depend on its revision, and return the answer.

    Raises:
        TensorMapError: What `track_of` and `LiveTrack.observe` raise.
    """
    while True:
        found, live, georeference = track_of(running, map_slug, track_id)
        with suppress(TrackUnloaded):  # between both lines; now it is found as it was saved
            observation = observation_for(found.localizer)
            require_measured(found.localizer, observation.signatures)
            step = found.observe(observation)
            running.metrics.localized("track", step.reason)
            drives = found.localizer.map.trajectory.drives
            return StepAnswer(found.id, step, live, georeference, drives)


def track_of(
    running: Service, map_slug: str, track_id: str
) -> tuple[LiveTrack, str | None, Georeference]:
    """Return a track, the live revision of its map, and where its revision is on the Earth.

    Raises:
        MapNotFound: If there is no such map.
        TrackNotFound: If the map has no such track, or it was removed.
        TensorMapError: What `LoadedRevisions.named` raises, if an earlier process had the track.
    """
    record = running.store.maps.get(map_slug)
    found = running.tracks.get(record.id, track_id, partial(_localizer, running, map_slug))
    aside = found.localizer.map.drives_aside
    return found, record.live_revision, Georeference(record.anchor, aside)


def _localizer(running: Service, map_slug: str, revision: str) -> Localizer:
    return running.revisions.named(map_slug, revision).localizer


def _signatures_and_image(
    localizer: Localizer,
    body: bytes,
    content_type: str | None,
    running: Service,
    query: ObservationQuery,
) -> tuple[tuple[Signature, ...], Image | None]:
    """Return the signatures of an observation, and its image unless signatures came."""
    kind = media_type(content_type)
    if kind in {"application/json", SIGNATURE_TYPE, IMAGE_TYPE}:
        _require_no_scan_options(query)
    if kind == SIGNATURE_TYPE and body[:1] == bytes([OBSERVATION_LAYOUT]):
        raise core.InvalidSignature(
            f"layout {OBSERVATION_LAYOUT} is for the track's WebSocket, .../stream: wanted the"
            " signatures alone, with sequence, timestamp_s and travelled_m as query parameters"
        )
    if kind in {"application/json", SIGNATURE_TYPE}:
        return read_signatures(body, content_type), None
    if kind == IMAGE_TYPE:
        image = read_image(body, localizer.map.parameters.grid)
        return localizer.basis.encode(image), image
    height_m = localizer.map.parameters.sensor_height_m
    scan = read_query(body, content_type, query, running.settings, height_m)
    image = localizer.basis.image(scan, query.sensor_height_m)
    return localizer.basis.encode(image), image


def _require_no_scan_options(query: ObservationQuery) -> None:
    given = query.model_fields_set & SensorIn.model_fields.keys()
    if given:
        name = SensorIn.model_fields[min(given)].alias or min(given)
        raise core.InvalidParameters(
            f"{name} is an option of scans, and the body is signatures or an image: send no {name}"
        )
