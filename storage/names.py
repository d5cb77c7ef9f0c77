"""Names: slugs that clients choose, first digits of digests, and ids that paths are built from."""

import re
import uuid

from storage.errors import InvalidSlug

SLUG_PATTERN = r"^[a-z0-9][a-z0-9._-]{0,63}$"
FEWEST_DIGITS = 12
"""Fewest hex digits of a digest that name a revision or basis; 48 bits, a clash among a million of
them is 1 in 500."""
PREFIX_PATTERN = rf"[0-9a-f]{{{FEWEST_DIGITS},64}}"
"""A digest or the first digits of one, as clients name revisions."""
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
    if not re.fullmatch(SLUG_PATTERN, slug):
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
