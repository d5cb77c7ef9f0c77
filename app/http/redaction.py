"""Keys and tokens in texts that are logged or sent back."""

import re

# Incomplete or mistyped ones too: `app.access.secrets` reads them, and is stricter.
_KEY = re.compile(r"(tmt?)_[0-9A-Za-z]+_[\w-]{8,}")
_HIDDEN = "(hidden)"
_chosen: dict[str, re.Pattern[str]] = {}  # keys that an operator chose, which look like any text


def hide(key: str) -> None:
    """Replace a key that an operator chose in all texts of this process, from now on."""
    _chosen.setdefault(key, re.compile("".join(map(_written, key))))


def without_keys(text: str) -> str:
    """Return a text with all keys and tokens in it replaced.

    A key that was put into a path by mistake is then not in the logs as well.

    Examples:
        >>> without_keys("/v1/maps/tmt_0123456789abcdef_AbCdEfGhIjKl/live")
        '/v1/maps/tmt_(hidden)/live'
    """
    for chosen in tuple(_chosen.values()):
        text = chosen.sub(_HIDDEN, text)
    return _KEY.sub(rf"\1_{_HIDDEN}", text)


def _written(character: str) -> str:
    """Return a pattern of a character as it is, percent-encoded once or more, or escaped."""
    code = f"{ord(character):02x}"
    encoded = "".join(f"[{digit}{digit.upper()}]" if digit.isalpha() else digit for digit in code)
    own = r"(?: |\+)" if character == " " else re.escape(character)
    escaped = r"\\{0,3}" if character in "\"'\\" else ""
    return f"(?:{escaped}{own}|%(?:25)*{encoded})"
