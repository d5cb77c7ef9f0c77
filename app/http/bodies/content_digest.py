"""`Content-Digest` (RFC 9530): whether a body was received as it was sent."""

import base64
import binascii
import hashlib
import re

from app.http.errors import DigestMismatch

_ALGORITHMS = {"sha-256": hashlib.sha256, "sha-512": hashlib.sha512}
_MEMBER = re.compile(r"\s*([a-z0-9-]+)=:([A-Za-z0-9+/=]*):\s*")


class ContentDigest:
    """The digests of a header whose algorithms we know, compared with those of the body."""

    def __init__(self, header: str) -> None:
        """Parse a header; unknown algorithms are ignored, as the RFC allows.

        Raises:
            DigestMismatch: If it cannot be parsed.
        """
        self._sent: dict[str, bytes] = {}
        for member in header.split(",") if header.strip() else ():
            found = _MEMBER.fullmatch(member)
            if found is None:
                raise DigestMismatch(f"Content-Digest is {header[:120]!r}, wanted sha-256=:BASE64:")
            try:
                self._sent[found[1]] = base64.b64decode(found[2], validate=True)
            except binascii.Error as error:
                raise DigestMismatch(f"Content-Digest {found[1]} is no base64: {error}") from error
        self._computed = {name: _ALGORITHMS[name]() for name in self._sent if name in _ALGORITHMS}

    def __bool__(self) -> bool:
        return bool(self._computed)

    def add(self, chunk: bytes) -> None:
        """Add the next bytes of the body."""
        for digest in self._computed.values():
            digest.update(chunk)

    def check(self) -> None:
        """Compare, at the end of the body.

        Raises:
            DigestMismatch: If the body has another digest.
        """
        for name, digest in self._computed.items():
            sent, computed = self._sent[name], digest.digest()
            if computed != sent:
                raise DigestMismatch(
                    f"Content-Digest {name} is {base64.b64encode(sent).decode()[:88]}, the body"
                    f" has {base64.b64encode(computed).decode()}"
                )
