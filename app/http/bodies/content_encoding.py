"""Compressed bodies: unpacked a piece at a time, so that no bomb takes the memory it asks for."""

import zlib
from collections.abc import Iterator
from typing import Protocol

import zstandard

from app.http.errors import BodyTooLarge, MalformedBody, UnsupportedBody

__all__ = ["ENCODINGS", "Decoder", "decoder_of"]

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


class Decoder(Protocol):
    """Unpacks a body that comes in chunks."""

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Give what a chunk unpacks to, in pieces.

        Raises:
            MalformedBody: If it does not unpack, or has too many members for what they hold.
            BodyTooLarge: If it unpacks to many times its size.
        """

    def finish(self) -> None:
        """Check that the end was reached.

        Raises:
            MalformedBody: If more should have come.
        """


def decoder_of(content_encoding: str) -> Decoder | None:
    """Return what unpacks a body of this Content-Encoding, `None` if it is not packed.

    Raises:
        UnsupportedBody: If it is none that we know; so is one upon another.
    """
    match content_encoding.strip().lower():
        case "" | "identity":
            return None
        case "gzip" | "x-gzip":
            return _Gzip()
        case "zstd":
            return _Zstd()
        case other:
            wanted = ", ".join(ENCODINGS)
            raise UnsupportedBody(f"Content-Encoding is {other[:40]!r}, wanted {wanted} or none")


class _Budget:
    """What may come out of a body, and of how many members or frames, for what went in."""

    def __init__(self, encoding: str) -> None:
        self._encoding = encoding
        self._sent = self._unpacked = self._members = 0

    def sent(self, count: int) -> None:
        """Count bytes as they came."""
        self._sent += count

    def member(self) -> None:
        """Count a member that begins.

        Raises:
            MalformedBody: If there are too many for what they hold.
        """
        self._members += 1
        most = _STRAY_MEMBERS + self._unpacked // _MEMBER_BYTES
        if self._members > most:
            raise MalformedBody(
                f"the {self._encoding} body has more than {most} members for {self._unpacked}"
                f" bytes: beyond the first {_STRAY_MEMBERS} they must hold {_MEMBER_BYTES} each"
            )

    def unpacked(self, count: int) -> None:
        """Count bytes that were given.

        Raises:
            BodyTooLarge: If they are too many for those that were sent.
        """
        self._unpacked += count
        if self._unpacked > max(_ANY_RATIO_BYTES, self._sent * _RATIO):
            raise BodyTooLarge(
                f"the {self._encoding} body unpacks to more than {_RATIO} times its size:"
                f" {self._unpacked} bytes of the first {self._sent}"
            )


class _Gzip:
    def __init__(self) -> None:
        self._unpacker = zlib.decompressobj(wbits=31)
        self._budget = _Budget("gzip")

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        # What is left of a slice is copied for each member and piece: short slices keep it linear.
        for start in range(0, len(chunk), _GZIP_SLICE_BYTES):
            part = chunk[start : start + _GZIP_SLICE_BYTES]
            self._budget.sent(len(part))
            while part:
                if self._unpacker.eof:  # one member after the other
                    self._budget.member()
                    self._unpacker = zlib.decompressobj(wbits=31)
                try:
                    piece = self._unpacker.decompress(part, _PIECE_BYTES)
                except zlib.error as error:
                    raise MalformedBody(f"the gzip body does not unpack: {error}") from error
                yield piece
                self._budget.unpacked(len(piece))  # the reader's own limit comes first
                part = self._unpacker.unconsumed_tail or self._unpacker.unused_data

    def finish(self) -> None:
        if not self._unpacker.eof:
            raise MalformedBody("the gzip body ends before its end")


class _Zstd:
    def __init__(self) -> None:
        self._frames = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
        self._unpacker = self._frames.decompressobj()
        self._begun = False
        self._budget = _Budget("zstd")

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        for start in range(0, len(chunk), _ZSTD_SLICE_BYTES):
            part = chunk[start : start + _ZSTD_SLICE_BYTES]
            self._budget.sent(len(part))
            while part:
                if self._unpacker.eof:  # one frame after the other
                    self._budget.member()
                    self._unpacker = self._frames.decompressobj()
                self._begun = True
                try:
                    piece = self._unpacker.decompress(part)
                except zstandard.ZstdError as error:
                    raise MalformedBody(f"the zstd body does not unpack: {error}") from error
                yield piece
                self._budget.unpacked(len(piece))  # the reader's own limit comes first
                part = self._unpacker.unused_data if self._unpacker.eof else b""

    def finish(self) -> None:
        if not (self._begun and self._unpacker.eof):
            raise MalformedBody("the zstd body ends before its end")
