"""A download that survives the deletion of its file, whole or in parts."""

import os
import re
from http import HTTPStatus
from typing import Any, BinaryIO

from starlette.datastructures import Headers
from starlette.responses import FileResponse, Response
from starlette.types import Receive, Scope, Send

from app.http.answer_headers import (
    ACCEPT_RANGES,
    CONTENT_DISPOSITION,
    CONTENT_RANGE,
    ETAG,
    LAST_MODIFIED,
    headed,
)
from app.http.errors import RangeNotSatisfiable
from app.http.etags import is_held
from app.http.problems import problems

_OF_FILES = (ETAG, LAST_MODIFIED, ACCEPT_RANGES, CONTENT_DISPOSITION)
_RANGES = re.compile(r"\s*bytes\s*=(.*)", re.ASCII | re.IGNORECASE)
_RANGE = re.compile(r"\s*(\d{0,18})-(\d{0,18})\s*", re.ASCII)


def file_responses(media_type: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that answers with a file."""
    content = {"schema": {"type": "string", "format": "binary"}}
    return {
        200: {"content": {media_type: content}, **headed(*_OF_FILES)},
        206: {
            "description": "The parts that `Range` names.",
            "content": {media_type: content, "multipart/byteranges": content},
            **headed(*_OF_FILES, sometimes=(CONTENT_RANGE,)),  # of one part: several have their own
        },
        304: {"description": "The client has this file.", **headed(ETAG)},
        **problems(RangeNotSatisfiable),
    }


class OpenFileResponse(FileResponse):
    """The content of an open file, its parts by `Range`, or nothing if the client has it.

    The base opens its path after the status was sent, when it is too late to report that the file
    was deleted. This one uses the path of the open file under /proc, which works for deleted files.
    """

    def __init__(self, file: BinaryIO, **options: Any) -> None:  # noqa: ANN401 - those of the base
        self._file = file
        descriptor = file.fileno()
        super().__init__(f"/proc/self/fd/{descriptor}", stat_result=os.fstat(descriptor), **options)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file and close it.

        Raises:
            RangeNotSatisfiable: If the file has none of the parts.
        """
        with self._file:
            headers = Headers(scope=scope)
            etag = self.headers["etag"]
            if is_held(etag, headers.get("if-none-match")):
                held = Response(status_code=HTTPStatus.NOT_MODIFIED, headers={ETAG: etag})
                await held(scope, receive, send)
                return
            # The base answers what is no range in plain text, which RFC 9110, 14.2 lets us ignore.
            wanted = self._range(headers)
            others = [(name, value) for name, value in scope["headers"] if name != b"range"]
            ranges = [] if wanted is None else [(b"range", wanted.encode())]
            await super().__call__({**scope, "headers": [*others, *ranges]}, receive, send)

    def _range(self, headers: Headers) -> str | None:
        """Return those ranges of a request that the file has, `None` if it has to be sent whole."""
        current = {self.headers["etag"], self.headers["last-modified"]}
        found = _RANGES.fullmatch(headers.get("range", ""))
        if found is None or headers.get("if-range", self.headers["etag"]) not in current:
            return None
        ranges = [_RANGE.fullmatch(part) for part in found[1].split(",")]
        size = int(self.headers["content-length"])
        satisfiable = []
        for one in ranges:
            first, last = ("", "") if one is None else one.groups()
            if not (first or last) or (first and last and int(last) < int(first)):
                return None
            if int(first) < size if first else int(last) > 0:
                satisfiable.append(f"{first}-{last}")
        if not satisfiable:
            raise RangeNotSatisfiable(
                f"the file has {size} bytes, wanted a range that begins before its end, got"
                f" {headers['range'][:80]!r}",
                size,
            )
        return f"bytes={','.join(satisfiable)}"
