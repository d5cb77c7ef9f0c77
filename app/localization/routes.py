"""Localization of a scan, an image, signatures, or a batch of these."""

from typing import Annotated, TypeVar

import numpy as np
from fastapi import Query, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.http import errors
from app.http.bodies.bodies import Body, ContentType, described_body, required_type
from app.http.bodies.json_body import read_json
from app.http.client import require_client
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.localization.answers import Accept, Form, forms_of
from app.localization.prior_schemas import AnswerQuery, ImageQuery, LocalizeQuery, ScanQuery
from app.localization.scan_queries import BAD_SCAN_QUERY, SCAN_QUERY_TYPES, read_query
from app.localization.schemas import (
    MOST_QUERIES,
    SIGNATURE_TAGS,
    BatchIn,
    BatchOut,
    LocalizationOut,
    SignaturesIn,
)
from app.revisions.loaded import Answering
from app.service import MapSlug, Running
from core import errors as core
from core.encodings.signature import Signature, unpack_signatures
from core.projection.imager import Grid, Image
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision
from storage.formats.errors import EmptyBody

M = TypeVar("M", bound=BaseModel)

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

_FORMS = forms_of("LocalizationOut")
IMAGE_TYPE = "application/vnd.tensormap.image"
SIGNATURE_TYPE = "application/vnd.tensormap.signature"
BATCH_TYPE = "application/vnd.tensormap.signatures"
_MOST_MATCHES = 10_000  # of all queries of a batch: each takes a kilobyte
_LENGTH_BYTES = 2  # of each query of a packed batch
SIGNATURE_TYPES = {SIGNATURE_TYPE: "Packed: docs/reference/signature.md."}


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
    """Localize a scan, or several that become one, in the live revision."""
    priors = query.to_core()
    answering = running.revisions.live(map_slug)
    _require_sensor(answering, query.sensor)
    mapped = answering.localizer.map.parameters
    scan = read_query(body, content_type, query, running.settings, mapped.sensor_height_m)
    found = answering.localizer.localize_scan(
        scan, query.k, query.sensor_height_m, priors, query.min_probability
    )
    running.metrics.localized("scan", found.decision.reason)
    return Form.of(query.fields, accept).one(found, answering)


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
def localize_image(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    query: Annotated[ImageQuery, Query()],
    content_type: ContentType = None,
    accept: Accept = None,
) -> LocalizationOut | Response:
    """Localize an image in the live revision; its kind and grid are in `/basis`, `parameters`."""
    priors = query.to_core()
    answering = running.revisions.live(map_slug)
    _require_sensor(answering, query.sensor)
    mapped = answering.localizer.map.parameters.image
    if query.image not in {None, mapped}:
        raise core.SensorMismatch(
            f"the image is a {query.image} image, the map is of {mapped} images"
        )
    required_type(content_type, IMAGE_TYPE)
    image = read_image(body, answering.localizer.map.parameters.grid)
    found = answering.localizer.localize_image(image, query.k, priors, query.min_probability)
    running.metrics.localized("image", found.decision.reason)
    return Form.of(query.fields, accept).one(found, answering)


@router.post(
    "/signature",
    response_model=LocalizationOut,
    openapi_extra=described_body(SIGNATURE_TYPES, SignaturesIn),
    responses=_FORMS
    | problems(
        *_ANSWERING, core.StaleSignature, core.InvalidSignature, EmptyBody, *errors.ANY_BODY
    ),
)
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
    priors = query.to_core()
    signatures = read_signatures(body, content_type)
    answering = running.revisions.of_signature(map_slug, signatures[0].revision)
    found = answering.localizer.localize_signatures(
        signatures, query.k, priors, query.min_probability
    )
    running.metrics.localized("signature", found.decision.reason)
    return Form.of(query.fields, accept).one(found, answering)


@router.post(
    "/batch",
    response_model=BatchOut,
    openapi_extra=described_body(
        {BATCH_TYPE: "Each packed signature after its length in two bytes, little-endian."}, BatchIn
    ),
    responses=forms_of("each LocalizationOut")
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

    Each is answered as `/signature` answers it alone.
    """
    queries = read_batch(body, content_type)
    if len(queries) * query.k > _MOST_MATCHES:
        raise core.InvalidParameters(
            f"k is {query.k} for {len(queries)} queries, wanted at most {_MOST_MATCHES} matches"
        )
    found = []
    for signatures in queries:
        require_client()
        answering = running.revisions.of_signature(map_slug, signatures[0].revision)
        answer = answering.localizer.localize_signatures(
            signatures, query.k, min_probability=query.min_probability
        )
        found.append((answer, answering))
    for answer, _ in found:
        running.metrics.localized("signature", answer.decision.reason)
    return Form.of(query.fields, accept).many(found)


def _require_sensor(answering: Answering, sensor: str | None) -> None:
    mapped = answering.localizer.map.parameters.sensor
    if sensor is not None and sensor.lower() != mapped:
        raise core.SensorMismatch(f"the query is of sensor {sensor[:40]!r}, the map of {mapped!r}")


def read_image(body: bytes, grid: Grid) -> Image:
    """Read an image of a map's grid.

    Raises:
        EmptyBody: If the body is empty.
        InvalidImage: If their number is not that of the grid.
    """
    size = 4 * grid.rows * grid.columns
    if not body:
        raise EmptyBody(f"the body is empty, wanted {size} bytes")
    if len(body) != size:
        raise core.InvalidImage(
            f"the body has {len(body)} bytes, wanted {size}: {grid.rows} x {grid.columns} float32"
        )
    return Image(np.frombuffer(body, "<f4").reshape(grid.shape), grid)


def read_signatures(body: bytes, content_type: str | None) -> tuple[Signature, ...]:
    """Read one scan's signatures, packed or as JSON.

    Raises:
        EmptyBody: If the body is empty.
        UnsupportedBody: If they are of another type.
        InvalidSignature: If they are packed wrongly.
        RequestValidationError: If the JSON does not fit its schema.
    """
    if not body:
        raise EmptyBody("the body is empty, wanted signatures")
    if required_type(content_type, "application/json", SIGNATURE_TYPE) == SIGNATURE_TYPE:
        return unpack_signatures(body)
    return _read_json(body, SignaturesIn).to_core()


def read_batch(body: bytes, content_type: str | None) -> list[tuple[Signature, ...]]:
    """Read the signatures of several scans, packed or as JSON.

    Raises:
        EmptyBody: If there is none.
        UnsupportedBody: If they are of another type.
        InvalidSignature: If they are packed wrongly, or are too many.
        RequestValidationError: If the JSON does not fit its schema.
    """
    if not body:
        raise EmptyBody("the body is empty, wanted signatures")
    if required_type(content_type, "application/json", BATCH_TYPE) != BATCH_TYPE:
        return [query.to_core() for query in _read_json(body, BatchIn).queries]
    queries: list[tuple[Signature, ...]] = []
    start = 0
    while start < len(body):
        length = int.from_bytes(body[start : start + _LENGTH_BYTES], "little")
        start += _LENGTH_BYTES
        if start + length > len(body):
            raise core.InvalidSignature(
                f"query {len(queries)} has {length} bytes, the body ends after"
                f" {max(len(body) - start, 0)} of them"
            )
        if len(queries) == MOST_QUERIES:
            raise core.InvalidSignature(f"a batch has at most {MOST_QUERIES} queries")
        queries.append(unpack_signatures(body[start : start + length]))
        start += length
    return queries


def _read_json(body: bytes, model: type[M]) -> M:
    try:
        return read_json(body, model)
    except RequestValidationError as error:
        raise RequestValidationError(
            # pydantic's name of the form is not a part of the body's path.
            [
                {**item, "loc": tuple(p for p in item["loc"] if p not in SIGNATURE_TAGS)}
                for item in error.errors()
            ]
        ) from None
