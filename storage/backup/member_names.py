"""The names that what a backup holds may have: no other becomes a path."""

import re

from storage.files.image_file import IMAGE_FILE_NAME

_NAMES = re.compile(
    r"catalog\.sqlite3|store-id|manifest\.json"
    r"|maps/[0-9a-f]{32}/drives/[0-9a-f]{32}/chunks/[0-9a-f]{32}\.h5"
    rf"|maps/[0-9a-f]{{32}}/drives/[0-9a-f]{{32}}/images/{IMAGE_FILE_NAME}"
    r"|maps/[0-9a-f]{32}/revisions/[0-9a-f]{64}\.[0-9a-f]{8}\.h5"
    r"|bases/[0-9a-f]{64}\.[0-9a-f]{8}\.h5"
)


def may_be_member(name: str) -> bool:
    """Return whether a backup may hold a file of this name."""
    return _NAMES.fullmatch(name) is not None
