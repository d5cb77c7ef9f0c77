"""The result of an upload over the wire."""

from collections.abc import Iterable

from pydantic import BaseModel, Field

from app.drives.schemas import IndexRangeOut
from app.http.shown import Shown


class PresentOut(Shown):
    """Which scans of a drive are stored, so that an interrupted upload can be continued."""

    drive: str
    closed: bool = Field(description="A closed drive takes no new scans.")
    scans: int
    scans_without_returns: int = Field(
        description="Those whose returns were dropped after a build; they need not be sent again."
    )
    present: list[IndexRangeOut] = Field(description="The indices that are stored.")
    gaps: list[IndexRangeOut] = Field(description="The indices that are missing in between.")


class SetAsideOut(BaseModel):
    """A file of an upload that was not stored."""

    file: str = Field(description="Its name in the archive.")
    type: str = Field(description="The stable name of the error.")
    detail: str = Field(description="What was expected and what was sent.")


class UploadOut(BaseModel):
    """The result for the files of an upload; what is stored is on disk."""

    scans_stored: int
    scans_present: int
    files_set_aside: int
    stored: list[IndexRangeOut] = Field(description="Indices that are new.")
    present: list[IndexRangeOut] = Field(description="Those whose scan was there, the same.")
    set_aside: list[SetAsideOut] = Field(
        description="Files that were not stored, with the reason; the first thousand."
    )


def index_ranges(indices: Iterable[int]) -> list[IndexRangeOut]:
    """Return the ranges that indices make, in rising order.

    Examples:
        >>> [(r.first, r.last) for r in index_ranges([7, 1, 2, 2, 3])]
        [(1, 3), (7, 7)]
    """
    ranges: list[IndexRangeOut] = []
    for index in sorted(set(indices)):
        if ranges and ranges[-1].last == index - 1:
            ranges[-1].last = index
        else:
            ranges.append(IndexRangeOut(first=index, last=index))
    return ranges
