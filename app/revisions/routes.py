"""Revisions: immutable builds of a map, one of them live, with their bases and graphs."""

import json
import os
from typing import Annotated, Any

from fastapi import Path, Query, Response, status
from fastapi.responses import FileResponse
from pydantic import Field

from app.access.api_router import api_router
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.builds.anchor_notes import frame_notes
from app.builds.recall import DrivenMap, measure_recall
from app.http import errors
from app.http.answer_headers import ETAG, LOCATION, headed
from app.http.bodies.bodies import Body, ContentType, Json, described_body, required_type
from app.http.exact_types import QueryFlag
from app.http.open_file import OpenFileResponse, file_responses
from app.http.openapi import reference
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.maps.versions import IfMatch, shown_map, versions_seen
from app.revisions.basis_answers import (
    BASIS_ANSWERS,
    Accept,
    IfNoneMatch,
    basis_answer,
    basis_tag,
)
from app.revisions.comparison_schemas import ComparisonOut
from app.revisions.geojson import GEOJSON, features_of
from app.revisions.geojson_schemas import FeaturesOut
from app.revisions.import_schemas import ImportedOut
from app.revisions.imports import import_revision
from app.revisions.schemas import BasisOut, LiveIn, LiveOut, RevisionOut
from app.revisions.topology_schemas import TopologyOut
from app.service import Running, Service
from core.errors import InvalidMap, InvalidParameters, UnknownSegment
from core.mapping.tensormap import TensorMap
from storage import errors as stored
from storage.formats.errors import EmptyBody

router = api_router(tags=["revisions"])

RevisionId = Annotated[
    str, Path(alias="revision", description="Digest of a revision, or at least 12 first digits.")
]
OneRevision = Annotated[
    str | None, Query(alias="revision", description="A revision; the live one by default.")
]
Segments = Annotated[
    list[Annotated[int, Field(ge=0, lt=2**31)]] | None,
    Query(alias="segment", description="Only these segments; repeatable."),
]

MakeLive = Annotated[
    QueryFlag | None, Query(description="Make it live; the first one of a map always is.")
]

_HDF5 = "application/vnd.tensormap.map+hdf5"


@router.get(
    "/maps/{map}/revisions",
    dependencies=[needs(Scope.MAPS_READ)],
    responses=problems(
        stored.MapNotFound, InvalidParameters, errors.InvalidRequest, *errors.READING
    ),
)
def list_revisions(
    map_slug: MapSlug, running: Running, after: After = "", limit: Limit = 100
) -> PageOut[RevisionOut]:
    """List a map's revisions, newest first."""
    live = running.store.maps.get(map_slug).live_revision
    page = running.store.revisions.list(map_slug, after, limit)
    return page_out(page, lambda record: RevisionOut.from_record(record, live))


@router.post(
    "/maps/{map}/revisions",
    dependencies=[needs(Scope.MAPS_WRITE)],
    status_code=status.HTTP_201_CREATED,
    responses={
        201: headed(LOCATION),
        200: {
            "model": ImportedOut,
            "description": "The map has it already.",
            **headed(LOCATION),
        },
        **problems(
            stored.MapNotFound,
            InvalidMap,
            EmptyBody,
            *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
    openapi_extra=described_body({_HDF5: "A revision's file, as its download gives it."}),
)
@heavy
def import_a_revision(
    map_slug: MapSlug,
    running: Running,
    response: Response,
    body: Body,
    content_type: ContentType = None,
    make_live: MakeLive = None,
) -> ImportedOut:
    """Import a revision from a map's file, which is checked and rewritten.

    It has the same digest and gives the same answers. No build can be based on it, as the scans of
    its drives are not stored. Its recall is compared with the live revision's where the map has the
    drives that it was built of, with their images; `make_live` is not subject to that.
    """
    required_type(content_type, _HDF5)
    if not body:
        raise EmptyBody("the body is empty, wanted a map's file")
    imported = import_revision(running.store, map_slug, body, make_live=bool(make_live))
    record = imported.record
    running.collector.wake(map_slug)
    if not imported.added:
        response.status_code = status.HTTP_200_OK
    response.headers[LOCATION] = f"/v1/maps/{map_slug}/revisions/{record.digest}"
    return ImportedOut.from_import(imported, running.store.maps.get(map_slug).live_revision)


@router.get(
    "/maps/{map}/revisions/{revision}",
    dependencies=[needs(Scope.MAPS_READ)],
    responses=problems(*errors.NAMED_REVISION, *errors.READING),
)
def get_revision(map_slug: MapSlug, revision: RevisionId, running: Running) -> RevisionOut:
    """Return a revision."""
    live = running.store.maps.get(map_slug).live_revision
    return RevisionOut.from_record(running.store.revisions.get(map_slug, revision), live)


@router.get(
    "/maps/{map}/revisions/{revision}/file",
    dependencies=[needs(Scope.MAPS_READ)],
    response_class=FileResponse,
    responses={
        **file_responses(_HDF5),
        **problems(*errors.NAMED_REVISION, stored.CorruptFile, *errors.READING),
    },
)
@heavy
def download_revision(map_slug: MapSlug, revision: RevisionId, running: Running) -> FileResponse:
    """Download a revision as its HDF5 file, or with `Range` parts of it.

    With its ETag in `If-None-Match` the answer is 304.
    """
    record, file = running.store.revisions.open(map_slug, revision)
    # An import or a build may write the same content into a file with other bytes.
    written_ns = os.fstat(file.fileno()).st_mtime_ns
    return OpenFileResponse(
        file,
        media_type=_HDF5,
        filename=f"{map_slug}-{record.digest[:12]}.h5",
        headers={ETAG: f'"{record.digest}-{written_ns:x}"'},
    )


@router.get(
    "/maps/{map}/revisions/{revision}/comparison",
    dependencies=[needs(Scope.MAPS_READ)],
    responses=problems(*errors.REVISION, *errors.READING),
)
@heavy
def compare(
    map_slug: MapSlug,
    revision: RevisionId,
    running: Running,
    other: Annotated[
        str | None,
        Query(
            alias="with",
            description="The other one: its digest, or at least 12 first digits; the live one by"
            " default.",
        ),
    ] = None,
) -> ComparisonOut:
    """Compare the content of a revision, and its recall, with the live or another revision.

    Recall is on the scans that both have: each is a query, seen from beside and behind other cars,
    and is left out of the search. It takes some seconds on a map of thousands of scans.
    """
    store = running.store
    sides = []
    for name in (revision, other):
        tensor_map = running.revisions.get(map_slug, name).localizer.map
        sides.append((store.revisions.get(map_slug, tensor_map.revision), tensor_map))
    (record, tensor_map), (other_record, other_map) = this, that = sides
    recall = measure_recall(
        store,
        record.map_id,
        DrivenMap(record.drive_ids, tensor_map),
        DrivenMap(other_record.drive_ids, other_map),
    )
    return ComparisonOut.from_core(this, that, recall)


@router.delete(
    "/maps/{map}/revisions/{revision}",
    dependencies=[needs(Scope.MAPS_WRITE)],
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(*errors.NAMED_REVISION, stored.RevisionIsLive, *errors.WRITING),
)
def delete_revision(map_slug: MapSlug, revision: RevisionId, running: Running) -> None:
    """Remove a revision that is not live; signatures made with it are stale from then."""
    running.store.revisions.delete(map_slug, revision)


@router.put(
    "/maps/{map}/live",
    dependencies=[needs(Scope.MAPS_WRITE)],
    responses={
        200: headed(ETAG),
        **problems(
            *errors.NAMED_REVISION, stored.MapChanged, stored.CorruptFile, *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
)  # fmt: skip
@heavy
def make_live(
    map_slug: MapSlug,
    body: Json[LiveIn],
    running: Running,
    response: Response,
    if_match: IfMatch = None,
) -> LiveOut:
    """Make a revision live, a newer or an older one.

    One whose file is damaged does not become live: it is read whole before. Of an anchored map the
    revision that is live now is read too, to compare their frames.
    """
    note(f"revision {body.revision}")
    versions, revisions = versions_seen(if_match), running.store.revisions
    tensor_map = revisions.read(revisions.get(map_slug, body.revision))
    notes = _notes_on_frame(running, map_slug, tensor_map)
    record = revisions.set_live(map_slug, body.revision, if_versions=versions)
    running.collector.wake(map_slug)
    return LiveOut(**dict(shown_map(record, running, response)), notes=notes)


def _notes_on_frame(running: Service, map_slug: str, other: TensorMap) -> list[str]:
    if running.store.maps.get(map_slug).anchor is None:
        return []
    try:
        live = running.revisions.live(map_slug).localizer.map
    except (stored.NoLiveRevision, stored.CorruptFile):  # a damaged one is to be replaced
        return []
    return list(frame_notes(live, other, is_live=True))


@router.get(
    "/maps/{map}/basis",
    dependencies=[needs(Scope.MAPS_READ, Scope.LOCALIZE)],
    response_model=BasisOut,
    responses={
        **BASIS_ANSWERS,
        **problems(*errors.REVISION, *errors.READING, UnknownSegment, errors.InvalidRequest),
    },
)
@heavy
def get_basis(
    map_slug: MapSlug,
    running: Running,
    revision: OneRevision = None,
    segments: Segments = None,
    accept: Accept = "",
    if_none_match: IfNoneMatch = None,
) -> Any:  # noqa: ANN401 - JSON by its model, or bytes as they are
    """Download the basis to make signatures with, as JSON or, on `Accept`, as NumPy's npz.

    Only the basis of all segments has an ETag. It is of the basis and the `parameters` that
    vehicles need, not of the revision, and weak: revisions with the same of both have the same
    ETag, so that a vehicle need not download it again after a drive was added. Their `least_cells`
    differ: every answer, 304 too, has that of its revision in the header `TensorMap-Least-Cells`. A
    harmonic map has one basis for all its segments, and returns it for any of them.
    """
    tensor_map = running.revisions.get(map_slug, revision).localizer.map
    tag = None
    if segments is None:
        tag = basis_tag(tensor_map.basis_digest, tensor_map.parameters)
    return basis_answer(
        lambda: tensor_map.basis(segments),
        accept,
        if_none_match,
        tag=tag,
        least_cells=tensor_map.least_cells,
    )


@router.get(
    "/maps/{map}/topology",
    dependencies=[needs(Scope.MAPS_READ)],
    responses=problems(*errors.REVISION, *errors.READING),
)
@heavy
def get_topology(map_slug: MapSlug, running: Running, revision: OneRevision = None) -> TopologyOut:
    """Return a map as a graph: nodes where segments end and drives meet, edges along streets."""
    answering = running.revisions.get(map_slug, revision)
    return TopologyOut.from_core(answering.localizer.map, answering.georeference)


@router.get(
    "/maps/{map}/geojson",
    dependencies=[needs(Scope.MAPS_READ)],
    response_class=Response,
    responses={
        200: {"content": {GEOJSON: {"schema": reference(FeaturesOut)}}},
        **problems(*errors.REVISION, stored.MapNotAnchored, *errors.READING),
    },
)
@heavy
def get_geojson(map_slug: MapSlug, running: Running, revision: OneRevision = None) -> Response:
    """Return the drives, streets and nodes of a map on the Earth, as GeoJSON (RFC 7946).

    Positions are longitude, latitude and altitude; nodes also have metres. The map needs an anchor;
    drives without poses, and those that lie beside the others, have no place and are left out.
    Lines end where poses are unknown or more than 25 m apart, and are cut at 180 degrees of
    longitude: then a street is a MultiLineString.
    """
    answering = running.revisions.get(map_slug, revision)
    if answering.anchor is None:
        raise stored.MapNotAnchored(f"map {map_slug!r} has no anchor: set one with PATCH")
    features = features_of(answering.localizer.map, answering.georeference)
    body = json.dumps({"type": "FeatureCollection", "features": features})
    return Response(body, media_type=GEOJSON)
