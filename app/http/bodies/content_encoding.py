"""Compressed bodies: decompressed in pieces, so that a bomb takes no more memory than others."""

import zlib
from collections.abc import Callable, Iterator
from typing import Any

import zstandard

from app.http.errors import BodyTooLarge, MalformedBody, UnsupportedBody

ENCODINGS = ("gzip", "zstd")
_PIECE_BYTES = 2**20
_GZIP_SLICE_BYTES = 2**12
# A recorded scan is compressed to a half or a tenth, as text to a fifth, a cloud of which nine in
# ten points are NaN to a fiftieth. Zeros reach 1000 in gzip and more in zstd: little is sent and
# much is done. The ratio of small bodies is not limited.
_RATIO, _ANY_RATIO_BYTES = 200, 16 * 2**20
# bgzip makes a member of each 64 KiB. Starting one takes as long as decompressing 1 or 2 KiB.
_STRAY_MEMBERS, _MEMBER_BYTES = 1000, 2**10
# Of zstd's blocks the smallest has 4 bytes and gives 128 KiB: a slice gives at most 32 MiB.
_ZSTD_SLICE_BYTES = 2**10
_ZSTD_WINDOW_BYTES = 8 * 2**20  # RFC 9659: the most that a receiver must support


class Decoder:
    """Decompresses a body in chunks, one member or frame after another.

    Args:
        encoding: The encoding's name, for errors.
        begin: Returns a decompressor of the next member.
        unpack: Returns a decompressed piece of a part, given the decompressor.
        slice_bytes: How much is decompressed at once.
    """

    def __init__(
        self,
        encoding: str,
        begin: Callable[[], Any],
        unpack: Callable[[Any, bytes], bytes],
        slice_bytes: int,
    ) -> None:
        self._encoding, self._begin, self._unpack = encoding, begin, unpack
        self._slice_bytes = slice_bytes
        self._unpacker = begin()
        self._sent = self._unpacked = self._members = 0

    def again(self) -> "Decoder":
        """Return a decoder of the same encoding that has read nothing."""
        return Decoder(self._encoding, self._begin, self._unpack, self._slice_bytes)

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Yield a chunk decompressed, in pieces.

        Raises:
            MalformedBody: If it cannot be decompressed, or has too many members for their content.
            BodyTooLarge: If it becomes many times its size.
        """
        # The rest of a slice is copied for each member and piece: short slices keep this linear.
        for start in range(0, len(chunk), self._slice_bytes):
            part = chunk[start : start + self._slice_bytes]
            self._sent += len(part)
            while part:
                if self._unpacker.eof:
                    self._require_filled_members()
                    self._unpacker = self._begin()
                try:
                    piece = self._unpack(self._unpacker, part)
                except (zlib.error, zstandard.ZstdError) as error:
                    raise MalformedBody(
                        f"the {self._encoding} body does not unpack: {error}"
                    ) from error
                yield piece
                self._require_proportion(len(piece))  # after the reader's own limit
                part = self._unpacker.unconsumed_tail or self._unpacker.unused_data

    def finish(self) -> None:
        """Check that the end was reached.

        Raises:
            MalformedBody: If the body is incomplete.
        """
        if not self._unpacker.eof:
            raise MalformedBody(f"the {self._encoding} body ends before its end")

    def _require_filled_members(self) -> None:
        """Count a member that begins; reject too many for their content."""
        self._members += 1
        most = _STRAY_MEMBERS + self._unpacked // _MEMBER_BYTES
        if self._members > most:
            raise MalformedBody(
                f"the {self._encoding} body has more than {most} members for {self._unpacked}"
                f" bytes: beyond the first {_STRAY_MEMBERS} they must hold {_MEMBER_BYTES} each"
            )

    def _require_proportion(self, count: int) -> None:
        """Count decompressed bytes; reject too many for those that were sent."""
        self._unpacked += count
        if self._unpacked > max(_ANY_RATIO_BYTES, self._sent * _RATIO):
            raise BodyTooLarge(
                f"the {self._encoding} body unpacks to more than {_RATIO} times its size:"
                f" {self._unpacked} bytes of the first {self._sent}"
            )


def decoder_of(content_encoding: str) -> Decoder | None:
    """Return a decoder of this Content-Encoding, `None` if the body is not compressed.

    Raises:
        UnsupportedBody: If it is unknown, or several in sequence.
    """
    match content_encoding.strip().lower():
        case "" | "identity":
            return None
        case "gzip" | "x-gzip":
            return Decoder(
                "gzip",
                lambda: zlib.decompressobj(wbits=31),
                lambda unpacker, part: unpacker.decompress(part, _PIECE_BYTES),
                _GZIP_SLICE_BYTES,
            )
        case "zstd":
            frames = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
            return Decoder(
                "zstd",
                frames.decompressobj,
                lambda unpacker, part: unpacker.decompress(part),
                _ZSTD_SLICE_BYTES,
            )
        case other:
            known = ", ".join(ENCODINGS)
            raise UnsupportedBody(f"Content-Encoding is {other[:40]!r}, wanted {known} or none")
