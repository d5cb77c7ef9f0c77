"""Localizations: where am I, by a scan, an image or a signature."""

from typing import Annotated

import numpy as np
from fastapi import Query
from fastapi.exceptions import RequestValidationError

from app.access.scopes import Scope, needs
from app.drives.routes import BAD_SCAN
from app.http import errors
from app.http.bodies.bodies import SCAN_TYPES, Body, ContentType, described_body, media_type
from app.http.bodies.json_body import read_json
from app.http.pooled_route import heavy, pooled_router
from app.http.problems import problems
from app.localization.prior_schemas import HintsIn, MinProbability
from app.localization.schemas import (
    SIGNATURE_TAGS,
    LocalizationOut,
    NearestCount,
    SignaturesIn,
)
from app.revisions.loaded import Answering
from app.service import MapSlug, Running
from core import errors as core
from core.encodings.signature import Signature, unpack_signatures
from core.projection.imager import Grid, Image, ImageKind
from storage.errors import CorruptFile, MapNotFound, NoLiveRevision
from storage.formats.errors import EmptyBody
from storage.formats.scans.registry import read_scan

router = pooled_router(tags=["localizations"], prefix="/maps/{map}/localizations")

_ANSWERING = (
    MapNotFound,
    NoLiveRevision,
    CorruptFile,
    errors.InvalidRequest,
    core.InvalidParameters,
    core.UnknownSegment,
    *errors.READING,
)

IMAGE_TYPE = "application/vnd.tensormap.image"
SIGNATURE_TYPE = "application/vnd.tensormap.signature"
SIGNATURE_TYPES = {SIGNATURE_TYPE: "Packed: docs/reference/signature.md."}

SensorHeight = Annotated[
    float | None,
    Query(
        gt=0,
        lt=100,
        description="The query's sensor above ground, metres, if it is mounted otherwise than the"
        " map's; only maps of height images depend on it.",
    ),
]
Kind = Annotated[
    ImageKind | None,
    Query(alias="image", description="The image's kind; refused if it is not the map's."),
]
SensorName = Annotated[
    str | None,
    Query(alias="sensor", description="The query's sensor; refused if it is not the map's."),
]


@router.post(
    "/scan",
    dependencies=[needs(Scope.LOCALIZE)],
    openapi_extra=described_body(SCAN_TYPES),
    responses=problems(*_ANSWERING, core.SensorMismatch, *BAD_SCAN),
)
@heavy
def localize_scan(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    hints: HintsIn,
    content_type: ContentType = None,
    k: NearestCount = 1,
    sensor: SensorName = None,
    sensor_height_m: SensorHeight = None,
    min_probability: MinProbability = None,
) -> LocalizationOut:
    """Localize a scan in the live revision."""
    answering = running.revisions.live(map_slug)
    _require_sensor(answering, sensor)
    scan = read_scan(body, media_type=content_type, min_returns=running.settings.min_returns)
    found = answering.localizer.localize_scan(scan, k, sensor_height_m, hints, min_probability)
    running.metrics.localized("scan", found.verdict.reason)
    return LocalizationOut.from_core(found, answering.live_revision)


@router.post(
    "/image",
    dependencies=[needs(Scope.LOCALIZE)],
    openapi_extra=described_body(
        {
            IMAGE_TYPE: "Ranges, or heights above ground, in metres on the map's grid, little-"
            "endian float32, row after row."
        }
    ),
    responses=problems(
        *_ANSWERING, core.SensorMismatch, EmptyBody, core.InvalidImage, *errors.ANY_BODY
    ),
)
def localize_image(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    hints: HintsIn,
    content_type: ContentType = None,
    k: NearestCount = 1,
    sensor: SensorName = None,
    kind: Kind = None,
    min_probability: MinProbability = None,
) -> LocalizationOut:
    """Localize an image in the live revision; its kind and grid are in `/basis`, `parameters`."""
    answering = running.revisions.live(map_slug)
    _require_sensor(answering, sensor)
    _require_kind(answering, kind)
    if media_type(content_type) != IMAGE_TYPE:
        raise errors.UnsupportedBody(
            f"Content-Type is {(content_type or '')[:80]!r}, wanted {IMAGE_TYPE}"
        )
    image = read_image(body, answering.localizer.map.parameters.grid)
    found = answering.localizer.localize_image(image, k, hints, min_probability)
    running.metrics.localized("image", found.verdict.reason)
    return LocalizationOut.from_core(found, answering.live_revision)


@router.post(
    "/signature",
    dependencies=[needs(Scope.LOCALIZE)],
    openapi_extra=described_body(SIGNATURE_TYPES, SignaturesIn),
    responses=problems(
        *_ANSWERING, core.StaleSignature, core.InvalidSignature, EmptyBody, *errors.ANY_BODY
    ),
)
def localize_signature(
    map_slug: MapSlug,
    body: Body,
    running: Running,
    hints: HintsIn,
    content_type: ContentType = None,
    k: NearestCount = 1,
    min_probability: MinProbability = None,
) -> LocalizationOut:
    """Localize by signatures made with this map's bases.

    They name a basis, and the live revision answers if it has it, else the newest retained one
    that does; or they name a revision, and that one answers. Only the segments whose signatures
    came are searched.
    """
    signatures = read_signatures(body, content_type)
    answering = running.revisions.of_signature(map_slug, signatures[0].revision)
    found = answering.localizer.localize_signatures(signatures, k, hints, min_probability)
    running.metrics.localized("signature", found.verdict.reason)
    return LocalizationOut.from_core(found, answering.live_revision)


def _require_sensor(answering: Answering, sensor: str | None) -> None:
    mapped = answering.localizer.map.parameters.sensor
    if sensor is not None and sensor.lower() != mapped:
        raise core.SensorMismatch(f"the query is of sensor {sensor[:40]!r}, the map of {mapped!r}")


def _require_kind(answering: Answering, kind: ImageKind | None) -> None:
    mapped = answering.localizer.map.parameters.image
    if kind is not None and kind != mapped:
        raise core.SensorMismatch(f"the image is a {kind} image, the map is of {mapped} images")


def read_image(body: bytes, grid: Grid) -> Image:
    """Read an image of a map's grid.

    Raises:
        EmptyBody: If no bytes came.
        InvalidImage: If they are not as many as the grid has cells.
    """
    wanted = 4 * grid.rows * grid.columns
    if not body:
        raise EmptyBody(f"no bytes came, wanted {wanted}")
    if len(body) != wanted:
        raise core.InvalidImage(
            f"{len(body)} bytes came, wanted {wanted}: {grid.rows} x {grid.columns} float32"
        )
    return Image(np.frombuffer(body, "<f4").reshape(grid.shape), grid)


def read_signatures(body: bytes, content_type: str | None) -> tuple[Signature, ...]:
    """Read one scan's signatures, packed or as JSON.

    Raises:
        EmptyBody: If no bytes came.
        UnsupportedBody: If they are of another type.
        InvalidSignature: If they are not packed as they should be.
        RequestValidationError: If the JSON is not as the API describes it.
    """
    if not body:
        raise EmptyBody("no bytes came, wanted signatures")
    kind = media_type(content_type)
    if kind == SIGNATURE_TYPE:
        return unpack_signatures(body)
    if kind != "application/json":
        raise errors.UnsupportedBody(
            f"Content-Type is {kind[:80]!r}, wanted application/json or {SIGNATURE_TYPE}"
        )
    try:
        return read_json(body, SignaturesIn).to_core()
    except RequestValidationError as error:
        raise RequestValidationError(
            # The encoding was told by the fields' names: it is no place in the body.
            [
                {**item, "loc": tuple(p for p in item["loc"] if p not in SIGNATURE_TAGS)}
                for item in error.errors()
            ]
        ) from None
