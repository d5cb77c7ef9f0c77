"""Localization of a scan, an image, signatures, or a batch of these."""

from typing import Annotated

from fastapi import Query, Response

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.http import errors
from app.http.answer_forms import Accept
from app.http.bodies.bodies import Body, ContentType, described_body, required_type
from app.http.client import require_client
from app.http.pooled_route import heavy, heavy_if, quick
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.localization.answers import FIX, answer_of, batch_of, form_of
from app.localization.axis_notes import axis_notes
from app.localization.limited_queries import require_measured
from app.localization.query_bodies import (
    BATCH_TYPE,
    IMAGE_TYPE,
    SIGNATURE_TYPES,
    of_query,
    read_batch,
    read_image,
    read_signatures,
)
from app.localization.query_schemas import AnswerQuery, ImageQuery, LocalizeQuery, ScanQuery
from app.localization.quick_queries import measured_query
from app.localization.scan_queries import BAD_SCAN_QUERY, SCAN_QUERY_TYPES, read_query
from app.localization.schemas import BatchOut, LocalizationOut
from app.localization.signature_schemas import BatchIn, SignaturesIn
from app.revisions.loaded import Answering
from app.service import Running
from core import errors as core
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision
from storage.formats.errors import EmptyBody

router = api_router(
    tags=["localizations"],
    prefix="/maps/{map}/localizations",
    dependencies=(needs(Scope.LOCALIZE),),
)

_ANSWERING = (
    MapNotFound,
    NoLiveRevision,
    CorruptFile,
    errors.InvalidRequest,
    core.InvalidParameters,
    core.UnknownSegment,
    *errors.READING,
)

_FORMS = FIX.responses("LocalizationOut")
_MOST_MATCHES = 10_000  # of all queries of a batch: each takes a kilobyte and most of a millisecond
_MANY_MATCHES = 32  # of one query: more take as long as a scan

if_many_matches = heavy_if(lambda given: given["query"].k > _MANY_MATCHES)


@router.post(
    "/scan",
    response_model=LocalizationOut,
    openapi_extra=described_body(SCAN_QUERY_TYPES),
    responses=_FORMS | problems(*_ANSWERING, core.SensorMismatch, *BAD_SCAN_QUERY),
)
@heavy
def localize_scan(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    query: Annotated[ScanQuery, Query()],
    content_type: ContentType = None,
    accept: Accept = None,
) -> LocalizationOut | Response:
    """Localize a scan, or several that become one, in the live revision.

    If it is not localized, `notes` says whether its axes are others than x forward, y left, z up.
    """
    form, priors = form_of(query.fields, accept), query.to_core()
    answering = running.revisions.live(map_slug)
    _require_sensor(answering, query.sensor)
    mapped = answering.localizer.map.parameters
    scan = read_query(body, content_type, query, running.settings, mapped.sensor_height_m)
    found = answering.localizer.localize_scan(
        scan,
        query.k,
        query.sensor_height_m,
        priors,
        query.min_probability,
        with_runner_up=form.shows("runner_up"),
    )
    running.metrics.localized("scan", found.decision.reason)
    notes: list[str] = []
    if not found.localized and form.shows("notes"):
        height_m = query.sensor_height_m or mapped.sensor_height_m
        notes = axis_notes(scan, height_m, mounted=query.mounting is not None)
    return answer_of(form, found, answering, notes)


@router.post(
    "/image",
    response_model=LocalizationOut,
    openapi_extra=described_body(
        {
            IMAGE_TYPE: "Ranges, or heights above ground, in metres on the map's grid, little-"
            "endian float32, row after row."
        }
    ),
    responses=_FORMS
    | problems(*_ANSWERING, core.SensorMismatch, EmptyBody, core.InvalidImage, *errors.ANY_BODY),
)
@if_many_matches
def localize_image(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    query: Annotated[ImageQuery, Query()],
    content_type: ContentType = None,
    accept: Accept = None,
) -> LocalizationOut | Response:
    """Localize an image in the live revision; its kind and grid are in `/basis`, `parameters`."""
    form, priors = form_of(query.fields, accept), query.to_core()
    answering = running.revisions.live(map_slug)
    _require_sensor(answering, query.sensor)
    mapped = answering.localizer.map.parameters.image
    if query.image not in {None, mapped}:
        raise core.SensorMismatch(
            f"the image is a {query.image} image, the map is of {mapped} images"
        )
    required_type(content_type, IMAGE_TYPE)
    image = read_image(body, answering.localizer.map.parameters.grid)
    found = answering.localizer.localize_image(
        image, query.k, priors, query.min_probability, with_runner_up=form.shows("runner_up")
    )
    running.metrics.localized("image", found.decision.reason)
    return answer_of(form, found, answering)


@router.post(
    "/signature",
    response_model=LocalizationOut,
    openapi_extra=described_body(SIGNATURE_TYPES, SignaturesIn),
    responses=_FORMS
    | problems(
        *_ANSWERING, core.StaleSignature, core.InvalidSignature, EmptyBody, *errors.ANY_BODY
    ),
)
@quick
@if_many_matches
def localize_signature(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    query: Annotated[LocalizeQuery, Query()],
    content_type: ContentType = None,
    accept: Accept = None,
) -> LocalizationOut | Response:
    """Localize signatures made with this map's bases.

    They name a basis, and the live revision answers if it has that basis, else the newest retained
    one that has it; or they name the revision that answers. Only the segments of the signatures
    are searched.
    """
    form, priors = form_of(query.fields, accept), query.to_core()
    signatures = read_signatures(body, content_type)
    answering = running.revisions.of_signature(map_slug, signatures[0].revision)
    require_measured(answering.localizer, signatures)
    with measured_query(answering.localizer, body, query):
        found = answering.localizer.localize_signatures(
            signatures,
            query.k,
            priors,
            query.min_probability,
            with_runner_up=form.shows("runner_up"),
        )
    running.metrics.localized("signature", found.decision.reason)
    return answer_of(form, found, answering)


@router.post(
    "/batch",
    response_model=BatchOut,
    openapi_extra=described_body(
        {BATCH_TYPE: "Each packed signature after its length in two bytes, little-endian."}, BatchIn
    ),
    responses=FIX.responses("each LocalizationOut")
    | problems(
        *_ANSWERING, core.StaleSignature, core.InvalidSignature, EmptyBody, *errors.ANY_BODY
    ),
)
@heavy
def localize_batch(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    query: Annotated[AnswerQuery, Query()],
    content_type: ContentType = None,
    accept: Accept = None,
) -> BatchOut | Response:
    """Localize several scans by their signatures; all are answered, or none if one is refused.

    Each is answered as `/signature` answers it alone. The error names the query, counted from 0.
    """
    form = form_of(query.fields, accept)
    queries = read_batch(body, content_type)
    if len(queries) * query.k > _MOST_MATCHES:
        raise core.InvalidParameters(
            f"k is {query.k} for {len(queries)} queries, wanted at most {_MOST_MATCHES} matches"
        )
    found = []
    for number, signatures in enumerate(queries):
        require_client()
        with of_query(number):
            answering = running.revisions.of_signature(map_slug, signatures[0].revision)
            answer = answering.localizer.localize_signatures(
                signatures,
                query.k,
                min_probability=query.min_probability,
                with_runner_up=form.shows("runner_up"),
            )
        found.append((answer, answering))
    for answer, _ in found:
        running.metrics.localized("signature", answer.decision.reason)
    return batch_of(form, found)


def _require_sensor(answering: Answering, sensor: str | None) -> None:
    mapped = answering.localizer.map.parameters.sensor
    if sensor is not None and sensor.lower() != mapped:
        raise core.SensorMismatch(f"the query is of sensor {sensor[:40]!r}, the map of {mapped!r}")
