"""Localization among all maps that a key may see: no map is named."""

from functools import partial
from typing import Annotated

from fastapi import Query, Response

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.http import errors
from app.http.answer_forms import Form, part_responses
from app.http.bodies.bodies import Body, ContentType, described_body
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.localization.all_maps_answer import AllMapsAnswer
from app.localization.all_maps_schemas import AllMapsAnswerOut, AllMapsQuery, AllMapsScanQuery
from app.localization.query_bodies import SIGNATURE_TYPES, read_signatures
from app.localization.scan_queries import BAD_SCAN_QUERY, SCAN_QUERY_TYPES, read_sensor_scan
from app.localization.signature_schemas import SignaturesIn
from app.service import Running, Service
from core import errors as core
from core.localization.all_maps import MatchInMap
from core.mapping.georeference import NOWHERE, Georeference
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision
from storage.formats.errors import EmptyBody

router = api_router(
    tags=["localizations"], prefix="/localizations", dependencies=(needs(Scope.LOCALIZE),)
)

_ANSWERING = (
    MapNotFound,
    NoLiveRevision,
    CorruptFile,
    errors.TooManyMaps,
    errors.InvalidRequest,
    core.InvalidParameters,
    *errors.READING,
)
_FORMS = part_responses("AllMapsAnswerOut")


@router.post(
    "/signature",
    response_model=AllMapsAnswerOut,
    openapi_extra=described_body(SIGNATURE_TYPES, SignaturesIn),
    responses=_FORMS
    | problems(
        *_ANSWERING,
        core.StaleSignature,
        core.UnknownSegment,
        core.InvalidSignature,
        EmptyBody,
        *errors.ANY_BODY,
    ),
)
@heavy
def localize_signature_in_all_maps(
    body: Body,
    running: Running,
    caller: CurrentCaller,
    query: Annotated[AllMapsQuery, Query()],
    content_type: ContentType = None,
) -> AllMapsAnswerOut | Response:
    """Localize a signature in all maps whose live revision has its basis.

    Maps have one basis if they are built with a shared one. The others are listed as not searched.
    A signature names the basis, or a live revision that has it.
    """
    form = Form.part(AllMapsAnswerOut, query.fields)
    signatures = read_signatures(body, content_type)
    answer = running.all_maps.signature(caller, signatures, query.k, query.min_probability)
    running.metrics.localized("signature", answer.found.decision.reason)
    return _answer(running, answer, form)


@router.post(
    "/scan",
    response_model=AllMapsAnswerOut,
    openapi_extra=described_body(SCAN_QUERY_TYPES),
    responses=_FORMS | problems(*_ANSWERING, core.SensorMismatch, *BAD_SCAN_QUERY),
)
@heavy
def localize_scan_in_all_maps(
    body: Body,
    running: Running,
    caller: CurrentCaller,
    query: Annotated[AllMapsScanQuery, Query()],
    content_type: ContentType = None,
) -> AllMapsAnswerOut | Response:
    """Localize a scan, or several that become one, in all maps.

    Each map without a shared basis is searched alone, which takes some milliseconds: a setting
    limits how many. If it is not localized, `notes` says whether its axes are others than
    x forward, y left, z up.
    """
    form = Form.part(AllMapsAnswerOut, query.fields)
    answer = running.all_maps.scan(
        caller,
        partial(read_sensor_scan, body, content_type, query, running.settings),
        query.sensor_height_m,
        query.k,
        query.min_probability,
        with_notes=form.shows("notes"),
    )
    running.metrics.localized("scan", answer.found.decision.reason)
    return _answer(running, answer, form)


def _answer(running: Service, found: AllMapsAnswer, form: Form) -> AllMapsAnswerOut | Response:
    whole = AllMapsAnswerOut.from_core(found, partial(_georeference, running))
    return form.json_response(whole)


def _georeference(running: Service, found: MatchInMap) -> Georeference:
    """Return where the map of a match is on the Earth."""
    try:
        anchor = running.store.maps.get(found.name).anchor
    except MapNotFound:  # removed meanwhile
        return NOWHERE
    return Georeference(anchor, found.aside)
