"""Routers under /v1: all of their routes are behind the key."""

from typing import Any

from fastapi import APIRouter, Depends

from app.access.dependency import require_access
from app.http.errors import KEY
from app.http.pooled_route import pooled_router
from app.http.problems import problems


def api_router(
    prefix: str = "",
    dependencies: tuple[Any, ...] = (),
    **options: Any,  # noqa: ANN401 - those of `APIRouter`
) -> APIRouter:
    """Return a router whose routes run in pools; each or its routes declare the scope they need.

    Its routes have their whole path: routers within routers are searched three times a request.
    """
    return pooled_router(
        prefix=f"/v1{prefix}",
        dependencies=[Depends(require_access), *dependencies],
        responses=problems(*KEY),
        **options,
    )
