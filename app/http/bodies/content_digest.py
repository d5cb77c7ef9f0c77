"""`Content-Digest` (RFC 9530): whether a body came as it was sent."""

import base64
import binascii
import hashlib
import re

from app.http.errors import DigestMismatch

_ALGORITHMS = {"sha-256": hashlib.sha256, "sha-512": hashlib.sha512}
_MEMBER = re.compile(r"\s*([a-z0-9-]+)=:([A-Za-z0-9+/=]*):\s*")


class ContentDigest:
    """The digests that a header names and we know, and those of what came, as it was sent."""

    def __init__(self, header: str) -> None:
        """Read a header; algorithms that we do not know are passed over, as the RFC has it.

        Raises:
            DigestMismatch: If it cannot be read.
        """
        self._wanted: dict[str, bytes] = {}
        for member in header.split(",") if header.strip() else ():
            found = _MEMBER.fullmatch(member)
            if found is None:
                raise DigestMismatch(f"Content-Digest is {header[:120]!r}, wanted sha-256=:BASE64:")
            try:
                self._wanted[found[1]] = base64.b64decode(found[2], validate=True)
            except binascii.Error as error:
                raise DigestMismatch(f"Content-Digest {found[1]} is no base64: {error}") from error
        self._came = {name: _ALGORITHMS[name]() for name in self._wanted if name in _ALGORITHMS}

    def __bool__(self) -> bool:
        return bool(self._came)

    def add(self, chunk: bytes) -> None:
        """Take the next bytes of the body."""
        for digest in self._came.values():
            digest.update(chunk)

    def check(self) -> None:
        """Compare, at the end of the body.

        Raises:
            DigestMismatch: If what came is something else.
        """
        for name, digest in self._came.items():
            if digest.digest() != self._wanted[name]:
                wanted, came = (
                    base64.b64encode(value).decode()
                    for value in (self._wanted[name], digest.digest())
                )
                raise DigestMismatch(
                    f"Content-Digest {name} is {wanted[:88]}, what came has {came}"
                )
