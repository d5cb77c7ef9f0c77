"""Compressed bodies: unpacked a piece at a time, so that no bomb takes the memory it asks for."""

import zlib
from collections.abc import Iterator
from typing import Protocol

import zstandard

from app.errors import MalformedBody, UnsupportedBody

__all__ = ["ENCODINGS", "Decoder", "decoder_of"]

ENCODINGS = ("gzip", "zstd")
_PIECE_BYTES = 2**20
# Of zstd's blocks the smallest has 4 bytes and gives 128 KiB: a slice gives at most 32 MiB.
_ZSTD_SLICE_BYTES = 2**10
_ZSTD_WINDOW_BYTES = 8 * 2**20  # RFC 9659: no more may be asked of whoever reads a body


class Decoder(Protocol):
    """Unpacks a body that comes in chunks."""

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Give what a chunk unpacks to, in pieces.

        Raises:
            MalformedBody: If it does not unpack.
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


class _Gzip:
    def __init__(self) -> None:
        self._unpacker = zlib.decompressobj(wbits=31)

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        while chunk:
            if self._unpacker.eof:  # one member after the other
                self._unpacker = zlib.decompressobj(wbits=31)
            try:
                yield self._unpacker.decompress(chunk, _PIECE_BYTES)
            except zlib.error as error:
                raise MalformedBody(f"the gzip body does not unpack: {error}") from error
            chunk = self._unpacker.unconsumed_tail or self._unpacker.unused_data

    def finish(self) -> None:
        if not self._unpacker.eof:
            raise MalformedBody("the gzip body ends before its end")


class _Zstd:
    def __init__(self) -> None:
        self._frames = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
        self._unpacker = self._frames.decompressobj()
        self._begun = False

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        for start in range(0, len(chunk), _ZSTD_SLICE_BYTES):
            part = chunk[start : start + _ZSTD_SLICE_BYTES]
            while part:
                if self._unpacker.eof:  # one frame after the other
                    self._unpacker = self._frames.decompressobj()
                self._begun = True
                try:
                    yield self._unpacker.decompress(part)
                except zstandard.ZstdError as error:
                    raise MalformedBody(f"the zstd body does not unpack: {error}") from error
                part = self._unpacker.unused_data if self._unpacker.eof else b""

    def finish(self) -> None:
        if not (self._begun and self._unpacker.eof):
            raise MalformedBody("the zstd body ends before its end")
