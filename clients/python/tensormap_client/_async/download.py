"""A large file of the service, downloaded in parts."""

from contextlib import suppress
from functools import partial
from http import HTTPStatus
from pathlib import Path

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
    unfinished = file.with_name(f".{file.name}.part")
    try:
        begin, size_bytes, tag = 0, 1, ""
        while begin < size_bytes:
            headers = {
                "Range": f"bytes={begin}-{begin + _PART_BYTES - 1}",
                "Accept-Encoding": "identity",
            }
            if begin:  # of another file, as after another import, the answer is all of it
                headers["If-Range"] = tag
            answer = await transport.request("GET", path, headers=headers, is_download=True)
            if answer.status_code == HTTPStatus.PARTIAL_CONTENT:
                sent, _, total = answer.headers.get("Content-Range", "").partition("/")
                if not (
                    sent.startswith(f"bytes {begin}-") and total.isdecimal() and answer.content
                ):
                    raise Unreachable(f"GET {path} was answered by another part: {sent[:80]!r}")
                size_bytes, tag = int(total), answer.headers.get("ETag", "")
            else:
                begin, size_bytes = 0, len(answer.content)
            await computed(partial(_write, unfinished, begin, answer.content))
            begin += len(answer.content)
        unfinished.replace(file)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
        raise


def _write(file: Path, begin: int, content: bytes) -> None:
    with file.open("r+b" if begin else "wb") as opened:
        opened.seek(begin)
        opened.write(content)
