"""Comparisons of two revisions of a map."""

from typing import Annotated

from fastapi import Query

from app.access.scopes import Scope, needs
from app.http.errors import READING, REVISION
from app.http.pooled_route import heavy, pooled_router
from app.http.problems import problems
from app.revisions.comparison_schemas import ComparisonOut
from app.revisions.recall import measure_recall
from app.revisions.routes import RevisionId
from app.service import MapSlug, Running

router = pooled_router(tags=["revisions"])

Other = Annotated[
    str | None,
    Query(
        alias="with",
        description="The other one: its digest, or at least 12 first digits; the live one by"
        " default.",
    ),
]


@router.get(
    "/maps/{map}/revisions/{revision}/comparison",
    dependencies=[needs(Scope.MAPS_READ)],
    responses=problems(*REVISION, *READING),
)
@heavy
def compare(
    map_slug: MapSlug, revision: RevisionId, running: Running, other: Other = None
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
        store, record.map_id, (record.drive_ids, tensor_map), (other_record.drive_ids, other_map)
    )
    return ComparisonOut.from_core(this, that, recall)
