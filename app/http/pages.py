"""Pages of lists."""

from collections.abc import Callable
from typing import Annotated, Generic, TypeVar

from fastapi import Query
from pydantic import BaseModel, Field

from storage.catalog import Page

R = TypeVar("R")
T = TypeVar("T")

After = Annotated[str, Query(description="`next_after` of the page before.", max_length=200)]
Limit = Annotated[int, Query(ge=1, le=1000, description="How many items a page has at most.")]


class PageOut(BaseModel, Generic[T]):
    """Some items of a list, in its order."""

    items: list[T]
    next_after: str | None = Field(description="`after` of the next page; null at the end.")


def page_out(page: Page[R], show: Callable[[R], T]) -> PageOut[T]:
    """Show a page of the catalog's records."""
    return PageOut(items=[show(record) for record in page.items], next_after=page.next_after)
