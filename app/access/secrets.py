"""Keys as they are sent, `tm_<id>_<secret>`, tokens, and the hash that is kept of either."""

import hashlib
import re
import secrets
from dataclasses import dataclass

KEY_PREFIX = "tm"
TOKEN_PREFIX = "tmt"  # noqa: S105 - it is no secret
_ID_BYTES = 8
_SECRET_BYTES = 32
# The first release's keys have an id of 4 bytes. 43 characters of base64url are 32 bytes.
# Looser than what is well formed: one that was cut off or mistyped is hidden too.
_ANYWHERE = re.compile(r"(tmt?)_[0-9A-Za-z]+_[\w-]{8,}")
_SENT = re.compile(r"tmt?_[0-9a-f]{8,32}_[A-Za-z0-9_-]{43}")


@dataclass(frozen=True, repr=False)
class Secret:
    """A key or token that was made just now.

    Attributes:
        id: Its public part, which names it in lists and in the audit log.
        text: The whole, as its holder sends it; shown once and never kept.
    """

    id: str
    text: str


def new_secret(prefix: str = KEY_PREFIX) -> Secret:
    """Make a key, or a token, of 256 random bits."""
    key_id = secrets.token_hex(_ID_BYTES)
    return Secret(key_id, f"{prefix}_{key_id}_{secrets.token_urlsafe(_SECRET_BYTES)}")


def is_well_formed(sent: str) -> bool:
    """Return whether a text could be a key or token that this service made."""
    return _SENT.fullmatch(sent) is not None


def is_token(sent: str) -> bool:
    """Return whether a text calls itself a token."""
    return sent.startswith(f"{TOKEN_PREFIX}_")


def hidden(text: str) -> str:
    """Return a text with the keys and tokens struck out that stand in it.

    Whoever puts one into a path by mistake does not put it into the logs as well.

    Examples:
        >>> hidden("/v1/maps/tmt_0123456789abcdef_AbCdEfGhIjKl/live")
        '/v1/maps/tmt_(hidden)/live'
    """
    return _ANYWHERE.sub(r"\1_(hidden)", text)


def secret_hash(sent: str) -> str:
    """Return the hash of a key as it is sent, id and all.

    A key holds 256 random bits, or is the operator's own choice of at least 16 characters, and it
    is hashed on every request: a slow hash would slow the service and stop nobody.
    """
    return hashlib.sha256(sent.encode()).hexdigest()
