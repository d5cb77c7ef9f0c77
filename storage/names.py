"""Names: the slugs that clients choose and the ids that paths are built from."""

import re
import uuid

from storage.errors import InvalidSlug

SLUG_PATTERN = r"^[a-z0-9][a-z0-9._-]{0,63}$"
_SLUG = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


RECYCLED = "~"
"""Slugs of what is in the recycle bin begin with it; all that clients choose sort before it."""


def checked_slug(slug: str) -> str:
    """Return `slug` if it is one.

    Lower case only, so that no two maps differ by case alone; no slash, space or percent sign, so
    that URLs need no escaping. Paths of files are built from ids, never from slugs.

    Raises:
        InvalidSlug: If it is not 1 to 64 of a-z, 0-9, `.`, `_`, `-`, beginning with a-z or 0-9.

    Examples:
        >>> checked_slug("2011_09_26_drive_0001")
        '2011_09_26_drive_0001'
    """
    if not _SLUG.fullmatch(slug):
        raise InvalidSlug(
            f"{slug[:80]!r} is no slug: wanted 1 to 64 of a-z, 0-9, '.', '_' and '-',"
            " beginning with a letter or digit"
        )
    return slug


def recycled_slug(row_id: str) -> str:
    """Return the slug of a map or drive that is in the recycle bin."""
    return f"{RECYCLED}{row_id}"


def is_recycled(slug: str) -> bool:
    """Return whether a slug is that of a map or drive in the recycle bin."""
    return slug.startswith(RECYCLED)


def new_id() -> str:
    """Return a new random id, 32 hex digits."""
    return uuid.uuid4().hex
