"""Keys and tokens in texts that are logged or sent back."""

import re

# Incomplete or mistyped ones too: `app.access.secrets` reads them, and is stricter.
_KEY = re.compile(r"(tmt?)_[0-9A-Za-z]+_[\w-]{8,}")


def without_keys(text: str) -> str:
    """Return a text with all keys and tokens in it replaced.

    A key that was put into a path by mistake is then not in the logs as well.

    Examples:
        >>> without_keys("/v1/maps/tmt_0123456789abcdef_AbCdEfGhIjKl/live")
        '/v1/maps/tmt_(hidden)/live'
    """
    return _KEY.sub(r"\1_(hidden)", text)
