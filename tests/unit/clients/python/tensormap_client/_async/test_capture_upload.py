"""A capture is hashed step by step, before its parts are sent."""

import asyncio
import hashlib
import threading
from pathlib import Path

import pytest
from tensormap_client import CaptureFiles
from tensormap_client._async import capture_upload
from tensormap_client._sync import capture_upload as sync_capture_upload
from tensormap_client.progress import NO_PROGRESS

WHOLE = b"0123abcdefghi"


@pytest.fixture
def capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CaptureFiles:
    """A capture of two files, of which three bytes are read at a time."""
    for module in (capture_upload, sync_capture_upload):
        monkeypatch.setattr(module, "_STEP_BYTES", 3)
    files = (tmp_path / "metadata.yaml", tmp_path / "bag_0.db3")
    for file, content in zip(files, (WHOLE[:4], WHOLE[4:]), strict=True):
        file.write_bytes(content)
    return CaptureFiles(files, (4, len(WHOLE) - 4))


def test_the_digest_is_that_of_all_files_in_order(capture) -> None:
    wanted = hashlib.sha256(WHOLE).hexdigest()
    assert asyncio.run(capture_upload._sha256(capture, NO_PROGRESS)) == wanted
    assert sync_capture_upload._sha256(capture, NO_PROGRESS) == wanted


def test_a_cancelled_upload_does_not_read_the_rest_of_its_capture(capture, monkeypatch) -> None:
    part = CaptureFiles.part
    read: list[int] = []

    async def main() -> None:
        loop, cancelled = asyncio.get_running_loop(), threading.Event()
        hashing = asyncio.create_task(capture_upload._sha256(capture, NO_PROGRESS))

        def cancel() -> None:
            hashing.cancel()
            cancelled.set()

        def read_part(files: CaptureFiles, begin: int, size_bytes: int) -> bytes:
            read.append(begin)
            loop.call_soon_threadsafe(cancel)
            cancelled.wait()
            return part(files, begin, size_bytes)

        monkeypatch.setattr(CaptureFiles, "part", read_part)
        with pytest.raises(asyncio.CancelledError):
            await hashing

    asyncio.run(main())
    assert read == [0]
