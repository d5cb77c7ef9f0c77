"""A tar stream, parsed while it arrives: one file in memory at a time, of bounded size.

The parser is a generator that requests bytes; `TarFeed.take` sends them as they arrive.

Python's `tarfile` reads extended headers of any size into memory. Untrusted streams need less of
the format: ustar headers, and the long names of GNU and PAX.
"""

import io
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import IO, TypeVar

from app.http.bodies.content_encoding import ENCODINGS
from app.http.errors import MalformedUpload
from core.errors import InvalidScan
from storage.formats.errors import MalformedScan, ScanTooLarge
from storage.formats.file_kind import kind_of

T = TypeVar("T")

_BLOCK = 512
_SKIP_BYTES = 2**16
_MAX_HEADER_BYTES = 2**16
_FILE, _FOLDER = {b"0", b"\0", b"7"}, b"5"
_GNU_NAME, _GNU_TARGET, _PAX, _PAX_GLOBAL = b"L", b"K", b"x", b"g"  # a target is of a link
_EXTENDED = {_GNU_NAME, _GNU_TARGET, _PAX, _PAX_GLOBAL}
_SIZE_LIMIT = 2**53
# Folders, links and long names are in every archive; each header takes the reader time, however
# little content it has. Some programs write three headers a file.
_STRAY_HEADERS, _FILE_BYTES_PER_HEADER = 10_000, 256
_EXTENDED_IN_A_ROW = 8
_LISTED_BYTES = 0  # of each file: only its name is read


@dataclass(frozen=True)
class TarMember:
    """A file in the stream.

    Attributes:
        name: The file's path in the archive.
        content: The file's bytes; why there are none if it is too long, or not a plain file.
    """

    name: str
    content: bytes | InvalidScan


# A parser that requests up to so many bytes, is sent them (none at the end), and returns a value.
_Reading = Generator[int, bytes, T]


class TarFeed:
    """The files of a tar stream whose bytes are passed as they arrive.

    Args:
        most_bytes: The largest file that is read.
        place: Opens a temporary file for the content of one.

    Attributes:
        has_end: Whether the zeros that end an archive were received: without them it may be cut off
            between two files. Not all programs write them, and readers must not require them
            (GNU tar's manual, "Basic Tar Format").
    """

    def __init__(self, most_bytes: int, place: Callable[[], IO[bytes]] = io.BytesIO) -> None:
        self._most_bytes = most_bytes
        self._place = place
        self.has_end = False
        self._headers = self._file_bytes = 0
        self._parser = self._files()
        self._next = next(self._parser)
        self._ended = False

    def take(self, chunk: bytes) -> Iterator[TarMember]:
        """Yield the files that end within the next bytes of the stream; no bytes are its end.

        Raises:
            MalformedUpload: If it is no tar stream or breaks off.
        """
        at = 0
        while not self._ended:
            piece: bytes | None = None
            if isinstance(self._next, TarMember):
                yield self._next
            elif at == len(chunk) and chunk:
                return
            else:
                piece = chunk[at : at + self._next]
                at += len(piece)
            try:
                self._next = self._parser.send(piece)
            except StopIteration:
                self._ended = True

    def _files(self) -> Generator[int | TarMember, bytes | None, None]:
        """Yield the files, and how many bytes are needed."""
        long_name: str | None = None
        extended = 0
        while (header := (yield from self._header())) is not None:
            size, kind = _size(header), header[156:157]
            self._require_files()
            extended = extended + 1 if kind in _EXTENDED else 0
            if extended > _EXTENDED_IN_A_ROW:
                raise MalformedUpload(
                    f"more than {_EXTENDED_IN_A_ROW} extended headers of the tar stream follow one"
                    " another, wanted a file"
                )
            if kind in _EXTENDED:
                if size > _MAX_HEADER_BYTES:
                    raise MalformedUpload(f"a header of the tar stream takes {size} bytes")
                content = yield from self._content(size)
                if kind == _GNU_NAME:
                    long_name = _text(content)
                elif kind == _PAX:
                    long_name = _pax_name(content) or long_name
                continue
            name, long_name = long_name or _name(header), None
            if kind not in _FILE:
                yield from self._skip(_padded(size))
                if kind != _FOLDER:
                    yield TarMember(name, MalformedScan("it is a link or device, no file"))
            elif size > self._most_bytes:
                too_large = f"it has {size} bytes, at most {self._most_bytes} are read"
                yield TarMember(name, ScanTooLarge(too_large))
                yield from self._skip(_padded(size))
                self._file_bytes += size
            else:
                self._file_bytes += size
                yield TarMember(name, (yield from self._content(size)))
        if extended and not self.has_end:
            raise MalformedUpload("the tar stream breaks off before the file of a long name")

    def _header(self) -> _Reading[bytes | None]:
        """Return the next header, `None` at the end of the stream."""
        block = yield from self._exactly(_BLOCK, "its next header")
        if block is None:
            return None
        if not block.strip(b"\0"):
            self.has_end = True
            while padding := (yield _SKIP_BYTES):  # a block of zeros ends the archive
                if padding.strip(b"\0"):
                    raise MalformedUpload(
                        "bytes that are no padding follow the end of the tar stream: wanted one"
                        " archive in a body, send several one by one"
                    )
            return None
        # The sum is of bytes, with blanks in its own place; some programs add signed bytes.
        rest = block[:148] + b" " * 8 + block[156:]
        stored, total = _octal(block[148:156]), sum(rest)
        if stored != total and stored != total - 256 * sum(byte > 127 for byte in rest):
            raise MalformedUpload(_no_header(block, is_first=not self._headers))
        return block

    def _require_files(self) -> None:
        """Count a header; reject a stream that has mostly headers."""
        self._headers += 1
        most = _STRAY_HEADERS + self._file_bytes // _FILE_BYTES_PER_HEADER
        if self._headers > most:
            raise MalformedUpload(
                f"the tar stream has more than {most} headers for {self._file_bytes} bytes of"
                f" files: beyond the first {_STRAY_HEADERS} there must be"
                f" {_FILE_BYTES_PER_HEADER} bytes of files a header"
            )

    def _content(self, size: int) -> _Reading[bytes]:
        content = (yield from self._exactly(size, "a file")) if size else b""
        if content is None:
            raise MalformedUpload(f"the tar stream breaks off before a file of {size} bytes")
        yield from self._skip(_padded(size) - size)
        return content

    def _skip(self, size: int) -> _Reading[None]:
        while size:
            chunk = yield min(size, _SKIP_BYTES)
            if not chunk:
                raise MalformedUpload("the tar stream breaks off within a file")
            size -= len(chunk)

    def _exactly(self, size: int, what: str) -> _Reading[bytes | None]:
        """Return so many bytes, `None` if the stream has ended before the first of them."""
        received = 0
        with self._place() as parts:
            while received < size:
                chunk = yield min(size - received, 2**20)
                if not chunk:
                    if not received:
                        return None
                    raise MalformedUpload(
                        f"the tar stream breaks off within {what}, after {received} of {size} bytes"
                    )
                parts.write(chunk)
                received += len(chunk)
            parts.seek(0)
            return parts.read()


def listed(pieces: Iterable[bytes]) -> Iterator[TarMember]:
    """Yield the files of a tar stream, or of its beginning, without their content.

    Raises:
        MalformedUpload: If it is no tar stream.
    """
    feed = TarFeed(_LISTED_BYTES)
    for piece in pieces:
        if piece:
            yield from feed.take(piece)


def _no_header(block: bytes, *, is_first: bool) -> str:
    """Return what is wrong with a block that is no header; the first one begins the body."""
    kind = kind_of(block) if is_first else None
    if kind in ENCODINGS:
        return (
            f"the body is {kind}, wanted a tar stream: with 'Content-Encoding: {kind}' it is"
            " decompressed"
        )
    if kind not in {None, "tar"}:  # a tar's header may be damaged
        return f"the body is {kind}, wanted a tar stream"
    return (
        f"a header begins with {block[:8]!r} and its checksum is wrong: is the body a tar stream?"
    )


def _padded(size: int) -> int:
    """Return the size of a file's content with the padding of its last block."""
    return size + -size % _BLOCK


def _size(header: bytes) -> int:
    field = header[124:136]
    size = int.from_bytes(field[1:], "big") if field[0] == 0x80 else _octal(field)
    if not 0 <= size < _SIZE_LIMIT:
        raise MalformedUpload(f"the size of a file in the tar stream is {field!r}")
    return size


def _octal(field: bytes) -> int:
    digits = field.strip(b" \0")
    try:
        return int(digits or b"0", 8) if digits.isdigit() or not digits else -1
    except ValueError:
        return -1


def _name(header: bytes) -> str:
    name, prefix = _text(header[:100]), _text(header[345:500])
    return f"{prefix}/{name}" if prefix and header[257:262] == b"ustar" else name


def _text(field: bytes) -> str:
    return field.partition(b"\0")[0].decode("utf-8", "replace")


def _pax_name(content: bytes) -> str | None:
    """Return the path in a PAX header: lines `LENGTH KEY=VALUE`."""
    for line in content.split(b"\n"):
        _, _, pair = line.partition(b" ")
        key, _, value = pair.partition(b"=")
        if key == b"path":
            return _text(value)
    return None
