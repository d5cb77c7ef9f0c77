"""The version of a map: shown as its ETag, and required by `If-Match`."""

import re
from typing import Annotated

from fastapi import Header, Response

from app.http.answer_headers import ETAG
from app.http.errors import InvalidRequest
from app.maps.schemas import MapOut
from app.service import Service
from storage.catalog import MapRecord

_ETAG = re.compile(r'\s*(?:W/)?"([0-9]{1,18})"\s*')
_ONE = r'(W/)?"[0-9]{1,18}"'
IfMatch = Annotated[
    str | None,
    Header(
        description="ETags of the map, one or several: change only one of those versions.",
        json_schema_extra={"pattern": rf"^(\*|{_ONE}(, *{_ONE})*)$"},
    ),
]


def shown_map(record: MapRecord, running: Service, response: Response) -> MapOut:
    """Return a map, with the ETag of its version in the head."""
    response.headers[ETAG] = f'"{record.version}"'
    return MapOut.from_record(record, running.settings.retention)


def versions_seen(if_match: str | None) -> tuple[int, ...] | None:
    """Return the versions of an If-Match, `None` if every version matches.

    Raises:
        InvalidRequest: If one is no ETag of a map.
    """
    if if_match is None or if_match.strip() == "*":
        return None
    found = [_ETAG.fullmatch(etag) for etag in if_match.split(",")]
    versions = tuple(int(etag[1]) for etag in found if etag is not None)
    if len(versions) < len(found):
        raise InvalidRequest(
            f"If-Match is {if_match[:80]!r}, wanted a map's ETag with its quotes,"
            ' as "4", or several'
        )
    return versions
