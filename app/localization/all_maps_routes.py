"""Localization among all maps that a key may see: no map is named."""

from functools import partial
from typing import Annotated

from fastapi import Query

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.http import errors
from app.http.bodies.bodies import Body, ContentType, described_body
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.localization.all_maps_schemas import AllMapsAnswerOut, AllMapsQuery, AllMapsScanQuery
from app.localization.query_bodies import SIGNATURE_TYPES, read_signatures
from app.localization.scan_queries import BAD_SCAN_QUERY, SCAN_QUERY_TYPES, read_query
from app.localization.schemas import SignaturesIn
from app.service import Running, Service
from core import errors as core
from core.localization.all_maps import MatchInMap
from core.mapping.georeference import NOWHERE, Georeference
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision, RevisionNotFound
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


@router.post(
    "/signature",
    openapi_extra=described_body(SIGNATURE_TYPES, SignaturesIn),
    responses=problems(
        *_ANSWERING, core.StaleSignature, core.InvalidSignature, EmptyBody, *errors.ANY_BODY
    ),
)
@heavy
def localize_signature_in_all_maps(
    body: Body,
    running: Running,
    caller: CurrentCaller,
    query: Annotated[AllMapsQuery, Query()],
    content_type: ContentType = None,
) -> AllMapsAnswerOut:
    """Localize a signature in all maps whose live revision has its basis.

    Maps have one basis if they are built with a shared one. The others are listed as not searched.
    """
    signatures = read_signatures(body, content_type)
    answer = running.all_maps.signature(caller, signatures, query.k, query.min_probability)
    running.metrics.localized("signature", answer.found.decision.reason)
    return AllMapsAnswerOut.from_core(answer, partial(_georeference, running))


@router.post(
    "/scan",
    openapi_extra=described_body(SCAN_QUERY_TYPES),
    responses=problems(*_ANSWERING, core.SensorMismatch, *BAD_SCAN_QUERY),
)
@heavy
def localize_scan_in_all_maps(
    body: Body,
    running: Running,
    caller: CurrentCaller,
    query: Annotated[AllMapsScanQuery, Query()],
    content_type: ContentType = None,
) -> AllMapsAnswerOut:
    """Localize a scan, or several that become one, in all maps.

    Each map without a shared basis is searched alone, which takes some milliseconds: a setting
    limits how many.
    """
    answer = running.all_maps.scan(
        caller,
        lambda height_m: read_query(body, content_type, query, running.settings, height_m),
        query.sensor_height_m,
        query.k,
        query.min_probability,
    )
    running.metrics.localized("scan", answer.found.decision.reason)
    return AllMapsAnswerOut.from_core(answer, partial(_georeference, running))


def _georeference(running: Service, found: MatchInMap) -> Georeference:
    """Return where the map of a match is on the Earth."""
    try:
        if running.store.maps.get(found.name).anchor is None:
            return NOWHERE
        return running.revisions.named(found.name, found.revision).georeference
    except (MapNotFound, NoLiveRevision, RevisionNotFound, CorruptFile):  # removed meanwhile
        return NOWHERE
