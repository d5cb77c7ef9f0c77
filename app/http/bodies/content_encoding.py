"""Compressed bodies: unpacked a piece at a time, so that no bomb takes the memory it asks for."""

import zlib
from collections.abc import Callable, Iterator
from typing import Any

import zstandard

from app.http.errors import BodyTooLarge, MalformedBody, UnsupportedBody

ENCODINGS = ("gzip", "zstd")
_PIECE_BYTES = 2**20
_GZIP_SLICE_BYTES = 2**12
# A recorded scan packs to a half or a tenth, text of it to a fifth, a cloud of which nine in ten
# points are NaN to a fiftieth. Zeros give 1000 in gzip and more in zstd, for which little is sent
# and much is done. Bodies that stay small may be as sparse as they like.
_RATIO, _ANY_RATIO_BYTES = 200, 16 * 2**20
# bgzip makes a member of each 64 KiB. To begin one takes as long as to unpack a kilobyte or two.
_STRAY_MEMBERS, _MEMBER_BYTES = 1000, 2**10
# Of zstd's blocks the smallest has 4 bytes and gives 128 KiB: a slice gives at most 32 MiB.
_ZSTD_SLICE_BYTES = 2**10
_ZSTD_WINDOW_BYTES = 8 * 2**20  # RFC 9659: no more may be asked of whoever reads a body


class Decoder:
    """Unpacks a body that comes in chunks, of one member or frame after another.

    Args:
        encoding: Its name, for errors.
        begin: Gives what unpacks the next member.
        unpack: Gives a piece of what a part unpacks to, with what unpacks.
        slice_bytes: How much is unpacked at once.
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

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Give what a chunk unpacks to, in pieces.

        Raises:
            MalformedBody: If it does not unpack, or has too many members for what they hold.
            BodyTooLarge: If it unpacks to many times its size.
        """
        # What is left of a slice is copied for each member and piece: short slices keep it linear.
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
                self._require_proportion(len(piece))  # the reader's own limit comes first
                part = self._unpacker.unconsumed_tail or self._unpacker.unused_data

    def finish(self) -> None:
        """Check that the end was reached.

        Raises:
            MalformedBody: If more should have come.
        """
        if not self._unpacker.eof:
            raise MalformedBody(f"the {self._encoding} body ends before its end")

    def _require_filled_members(self) -> None:
        """Count a member that begins; refuse too many for what they hold."""
        self._members += 1
        most = _STRAY_MEMBERS + self._unpacked // _MEMBER_BYTES
        if self._members > most:
            raise MalformedBody(
                f"the {self._encoding} body has more than {most} members for {self._unpacked}"
                f" bytes: beyond the first {_STRAY_MEMBERS} they must hold {_MEMBER_BYTES} each"
            )

    def _require_proportion(self, count: int) -> None:
        """Count bytes that were given; refuse too many for those that were sent."""
        self._unpacked += count
        if self._unpacked > max(_ANY_RATIO_BYTES, self._sent * _RATIO):
            raise BodyTooLarge(
                f"the {self._encoding} body unpacks to more than {_RATIO} times its size:"
                f" {self._unpacked} bytes of the first {self._sent}"
            )


def decoder_of(content_encoding: str) -> Decoder | None:
    """Return what unpacks a body of this Content-Encoding, `None` if it is not packed.

    Raises:
        UnsupportedBody: If it is none that we know; so is one upon another.
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
            wanted = ", ".join(ENCODINGS)
            raise UnsupportedBody(f"Content-Encoding is {other[:40]!r}, wanted {wanted} or none")
