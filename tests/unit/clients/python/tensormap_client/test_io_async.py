"""Workers of the asynchronous client."""

import asyncio

import pytest
from tensormap_client.io_async import AsyncWorkers, sleep


def test_the_first_failure_ends_the_waiting_of_the_others() -> None:
    ended: list[str] = []

    async def wait() -> None:
        try:
            await sleep(20.0)
        except asyncio.CancelledError:
            ended.append("cancelled")
            raise

    async def fail() -> None:
        raise OSError("rejected")

    async def main() -> None:
        async with AsyncWorkers(2) as workers:
            first = workers.start(wait)
            workers.start(fail)
            await first.result()

    with pytest.raises(OSError, match="rejected"):
        asyncio.run(main())
    assert ended == ["cancelled"]


def test_a_caller_that_is_cancelled_beside_a_failure_is_cancelled() -> None:
    async def fail() -> None:
        raise OSError("rejected")

    async def wait_for_both() -> None:
        async with AsyncWorkers(2) as workers:
            first = workers.start(sleep, 20.0)
            workers.start(fail)
            waiting = asyncio.current_task()
            assert waiting is not None
            asyncio.get_running_loop().call_soon(waiting.cancel)
            await first.result()

    async def main() -> None:
        waiting = asyncio.create_task(wait_for_both())
        with pytest.raises(asyncio.CancelledError):
            await waiting

    asyncio.run(main())
