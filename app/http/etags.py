"""ETags that a client has, as in RFC 9110, 13.1."""


def is_held(etag: str, if_none_match: str | None) -> bool:
    """Return whether a client has what an ETag names; weak and strong ones are equal.

    Examples:
        >>> is_held('"1"', 'W/"1", "2"'), is_held('"1"', "*"), is_held('"1"', None)
        (True, True, False)
    """
    held = {part.strip().removeprefix("W/") for part in (if_none_match or "").split(",")}
    return etag.removeprefix("W/") in held or "*" in held
