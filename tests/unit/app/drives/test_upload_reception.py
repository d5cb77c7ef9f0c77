"""Uploads that wait for another one of the same drive."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.requests import ClientDisconnect

from app.drives.upload_reception import _held


def request_whose_client_leaves(left: asyncio.Event) -> Any:
    async def receive() -> dict[str, str]:
        await left.wait()
        return {"type": "http.disconnect"}

    return SimpleNamespace(receive=receive)


def test_a_client_that_leaves_waits_no_longer_for_another_upload() -> None:
    async def waited() -> None:
        lock, left = asyncio.Lock(), asyncio.Event()
        async with lock:
            asyncio.get_running_loop().call_soon(left.set)
            with pytest.raises(ClientDisconnect):
                async with _held(lock, request_whose_client_leaves(left)):
                    pass
            assert lock.locked()
        async with lock:  # nobody else has it
            pass

    asyncio.run(asyncio.wait_for(waited(), 20.0))


def test_an_upload_goes_on_when_the_other_one_is_stored_and_the_next_one_after_it() -> None:
    async def waited() -> list[str]:
        lock, left, order = asyncio.Lock(), asyncio.Event(), []

        async def upload(name: str) -> None:
            async with _held(lock, request_whose_client_leaves(left)):
                order.append(name)
                await asyncio.sleep(0)
                order.append(name)

        async with lock:
            uploads = [asyncio.create_task(upload(name)) for name in ("first", "second")]
            await asyncio.sleep(0.01)
            assert order == []
        await asyncio.gather(*uploads)
        assert not lock.locked()
        return order

    found = asyncio.run(asyncio.wait_for(waited(), 20.0))
    assert found == ["first", "first", "second", "second"]
