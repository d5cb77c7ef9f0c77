"""The version of a map: shown as its ETag, and required by `If-Match`."""

import re
from typing import Annotated

from fastapi import Header, Response

from app.http.errors import InvalidRequest
from app.maps.schemas import MapOut
from app.service import Service
from storage.catalog import MapRecord

_ETAG = re.compile(r'\s*(?:\*|(?:W/)?"([0-9]{1,18})")\s*')
IfMatch = Annotated[
    str | None,
    Header(
        description="An ETag of the map: change only that version.",
        json_schema_extra={"pattern": r'^(\*|(W/)?"[0-9]{1,18}")$'},
    ),
]


def shown_map(record: MapRecord, running: Service, response: Response) -> MapOut:
    """Return a map, with the ETag of its version in the head."""
    response.headers["ETag"] = f'"{record.version}"'
    return MapOut.from_record(record, running.settings.retention)


def version_seen(if_match: str | None) -> int | None:
    """Return the version of an If-Match, `None` if every version matches.

    Raises:
        InvalidRequest: If it is no ETag of a map.
    """
    if if_match is None:
        return None
    found = _ETAG.fullmatch(if_match)
    if found is None:
        raise InvalidRequest(f"If-Match is {if_match[:80]!r}, wanted a map's ETag")
    return None if found[1] is None else int(found[1])
