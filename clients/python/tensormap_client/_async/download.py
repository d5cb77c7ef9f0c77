"""A large file of the service, downloaded in parts."""

import secrets
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import BinaryIO

import httpx2

from tensormap_client._async.transport import AsyncTransport
from tensormap_client.errors import Unreachable
from tensormap_client.io_async import computed

_PART_BYTES = 16 * 2**20


async def download(transport: AsyncTransport, path: str, file: Path) -> None:
    """Download a file; it has its name once it is whole, and replaces another one of that name.

    Each part is a request, so that a lost connection costs a part, and memory holds one.

    Args:
        transport: The connections to the service.
        path: The path that returns the file, or parts of it on `Range`.
        file: Where to store it.

    Raises:
        ClientError: If the service cannot be reached or has no such file.
        OSError: If the file cannot be written.
    """
    # A name of its own: another download to the same file may go on.
    unfinished = file.with_name(f".{file.name}.{secrets.token_hex(4)}.part")
    try:
        with unfinished.open("xb") as opened:
            begin, size_bytes, tag = 0, 1, ""
            while begin < size_bytes:
                headers = {
                    "Range": f"bytes={begin}-{begin + _PART_BYTES - 1}",
                    "Accept-Encoding": "identity",
                }
                if tag:  # of another file, as after another import, the answer is all of it
                    headers["If-Range"] = tag
                answer = await transport.request("GET", path, headers=headers, is_download=True)
                if answer.status_code == HTTPStatus.PARTIAL_CONTENT:
                    found = _total_bytes(answer, path, begin), answer.headers.get("ETag", "")
                    if begin and found != (size_bytes, tag):  # a cache took no notice of If-Range
                        raise Unreachable(f"GET {path}: the file changed during the download")
                    size_bytes, tag = found
                else:
                    begin, size_bytes = 0, len(answer.content)
                await computed(partial(_write, opened, begin, answer.content))
                begin += len(answer.content)
        unfinished.replace(file)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
        raise


def _total_bytes(answer: httpx2.Response, path: str, begin: int) -> int:
    sent, _, total = answer.headers.get("Content-Range", "").partition("/")
    if not (sent.startswith(f"bytes {begin}-") and total.isdecimal() and answer.content):
        raise Unreachable(f"GET {path} was answered by another part: {sent[:80]!r}")
    return int(total)


def _write(opened: BinaryIO, begin: int, content: bytes) -> None:
    opened.seek(begin)
    opened.truncate()
    opened.write(content)
