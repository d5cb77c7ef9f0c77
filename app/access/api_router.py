"""Routers under /v1: all of their routes are behind the key."""

from collections.abc import Callable
from typing import Any

from fastapi import APIRouter, Depends

from app.access.dependency import require_access
from app.http.errors import KEY
from app.http.pooled_route import PooledRoute
from app.http.problems import with_problems


class _KeyedRouter(APIRouter):
    """A router whose routes may all end in the errors of a key, beside their own."""

    def add_api_route(
        self,
        path: str,
        endpoint: Callable[..., Any],
        *,
        responses: dict[int | str, dict[str, Any]] | None = None,
        **options: Any,  # noqa: ANN401 - those of `APIRouter`
    ) -> None:
        """Add a route."""
        described = with_problems(responses or {}, *KEY)
        super().add_api_route(path, endpoint, responses=described, **options)


def api_router(
    prefix: str = "",
    dependencies: tuple[Any, ...] = (),
    **options: Any,  # noqa: ANN401 - those of `APIRouter`
) -> APIRouter:
    """Return a router whose routes run in pools; each or its routes declare the scope they need.

    Its routes have their whole path: routers within routers are searched three times a request.
    """
    return _KeyedRouter(
        prefix=f"/v1{prefix}",
        route_class=PooledRoute,
        dependencies=[Depends(require_access), *dependencies],
        **options,
    )
