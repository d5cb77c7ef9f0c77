"""Keys as they are sent, `tm_<id>_<secret>`, tokens, and the hashes that are stored."""

import hashlib
import re
import secrets
from dataclasses import dataclass

KEY_PREFIX = "tm"
TOKEN_PREFIX = "tmt"  # noqa: S105 - it is no secret
_ID_BYTES = 8
_SECRET_BYTES = 32
# The first release's keys have an id of 4 bytes. 43 characters of base64url are 32 bytes.
_SENT = re.compile(r"tmt?_[0-9a-f]{8,32}_[A-Za-z0-9_-]{43}")


@dataclass(frozen=True, repr=False)
class Secret:
    """A key or token that was made just now.

    Attributes:
        id: The public part, which names it in lists and in the audit log.
        text: The whole, as its holder sends it; shown once and never stored.
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
    """Return whether a text has the prefix of a token."""
    return sent.startswith(f"{TOKEN_PREFIX}_")


def secret_hash(sent: str) -> str:
    """Return the hash of a key as it is sent, id and all.

    A key has 256 random bits, or is the operator's own of at least 16 characters, and is hashed on
    every request: a slow hash would slow the service down without stopping an attack.
    """
    return hashlib.sha256(sent.encode()).hexdigest()
