"""The names of maps and drives in the paths of routes."""

from typing import Annotated

from fastapi import Path

from storage.names import SLUG_PATTERN

_SLUG = {"pattern": SLUG_PATTERN}  # described only: another name is not found, or invalid
MapSlug = Annotated[
    str,
    Path(
        alias="map",
        description="The map's name.",
        examples=["campus"],
        json_schema_extra=_SLUG,
    ),
]
DriveSlug = Annotated[
    str,
    Path(
        alias="drive",
        description="The drive's name.",
        examples=["monday"],
        json_schema_extra=_SLUG,
    ),
]
