"""Comparisons: what changed between two revisions of a map."""

from typing import Annotated

from fastapi import Query

from app.access.scopes import Scope, needs
from app.http.errors import READING, REVISION
from app.http.pooled_route import heavy, pooled_router
from app.http.problems import problems
from app.revisions.comparison import compare_revisions
from app.revisions.comparison_schemas import ComparisonOut
from app.revisions.loaded import Answering
from app.revisions.routes import RevisionId
from app.service import MapSlug, Running, Service
from core.mapping.tensormap import TensorMap
from storage.catalog import RevisionRecord

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
    """Compare a revision with the live or another one: what it holds, and what it finds.

    Recall is that on scans which both have, each asked without itself and as a vehicle would that
    stands beside it, behind other cars. It takes some seconds on a map of thousands of scans.
    """
    loaded = running.revisions
    this = loaded.named(map_slug, revision)
    compared = loaded.live(map_slug) if other is None else loaded.named(map_slug, other)
    return ComparisonOut.from_core(
        compare_revisions(
            running.store, _side(running, map_slug, this), _side(running, map_slug, compared)
        )
    )


def _side(
    running: Service, map_slug: str, answering: Answering
) -> tuple[RevisionRecord, TensorMap]:
    tensor_map = answering.localizer.map
    return running.store.revisions.get(map_slug, tensor_map.revision), tensor_map
