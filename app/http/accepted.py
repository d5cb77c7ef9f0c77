"""What a client accepts: media types with weights, as in RFC 9110, 12.5.1."""

from core.numbers import numbers_of

_JSON = ("application/json", "application/*", "*/*")  # the most exact one counts


def is_preferred(media_type: str, accept: str | None) -> bool:
    """Return whether a client wants a media type, which it names, rather than JSON.

    Args:
        media_type: The type, lower case.
        accept: The header `Accept`, `None` without one.

    Examples:
        >>> is_preferred("image/png", "image/png, application/json")
        True
        >>> is_preferred("image/png", "image/png;q=0.1, */*;q=0.2")
        False
    """
    if not accept or media_type not in accept.lower():
        return False
    weights = dict(_weighted(part) for part in accept.lower().split(","))
    weight = weights.get(media_type, 0.0)
    of_json = next((weights[kind] for kind in _JSON if kind in weights), 0.0)
    return weight > 0.0 and weight >= of_json


def _weighted(part: str) -> tuple[str, float]:
    """Return a media type and its weight: 1 without one, or if it is no number."""
    kind, *parameters = (piece.strip() for piece in part.split(";"))
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return kind, numbers_of([value])[0]
            except ValueError:
                break
    return kind, 1.0
