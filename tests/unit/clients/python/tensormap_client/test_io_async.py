"""Workers and streams of the asynchronous client."""

import asyncio
from collections.abc import Callable

import pytest
from tensormap_client import Unreachable
from tensormap_client.io_async import AsyncKept, AsyncStream, AsyncWorkers, sleep


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


def test_all_who_wait_for_a_kept_call_have_its_result_and_the_next_one_begins_another() -> None:
    calls: list[int] = []

    async def count() -> int:
        calls.append(1)
        await sleep(0.001)
        return len(calls)

    async def main() -> None:
        kept = AsyncKept(count)
        assert await asyncio.gather(*(kept.result() for _ in range(3))) == [1, 1, 1]
        assert not kept.is_begun
        assert await kept.result() == 2

    asyncio.run(main())


def test_all_who_wait_for_a_kept_call_that_fails_have_its_failure() -> None:
    async def fail() -> None:
        await sleep(0.001)
        raise OSError("lost")

    async def main() -> None:
        kept = AsyncKept(fail)
        found = await asyncio.gather(*(kept.result() for _ in range(3)), return_exceptions=True)
        assert [type(error) for error in found] == [OSError] * 3
        assert not kept.is_begun

    asyncio.run(main())


# asyncio itself logs it with Python 3.14 and newer, if it is shielded.
def test_a_kept_call_that_fails_when_nobody_waits_any_more_is_not_logged(
    caplog: pytest.LogCaptureFixture, collect_own: Callable[[], object]
) -> None:
    async def fail() -> None:
        await sleep(0.01)
        raise OSError("lost")

    async def main() -> None:
        kept = AsyncKept(fail)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(kept.result(), 0.001)
        await sleep(0.05)

    asyncio.run(main())
    collect_own()
    assert not caplog.records


def test_a_kept_call_of_a_closed_loop_is_none() -> None:
    async def wait() -> str:
        await sleep(0.01)
        return "done"

    kept = AsyncKept(wait)

    async def give_up() -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(kept.result(), 0.001)
        assert kept.is_begun

    loop = asyncio.new_event_loop()
    loop.run_until_complete(give_up())
    loop.close()  # as no library does: its tasks are not cancelled
    assert not kept.is_begun
    assert asyncio.run(kept.result()) == "done"


def test_a_stream_that_is_redirected_is_unreachable_and_nothing_is_sent_to_the_other_host() -> None:
    received: list[bytes] = []

    async def main() -> None:
        async def other(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            received.append(await reader.read(4096))
            writer.close()

        async def redirect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            port = elsewhere.sockets[0].getsockname()[1]
            lines = "HTTP/1.1 307 Temporary Redirect", f"Location: ws://localhost:{port}/x"
            writer.write("\r\n".join([*lines, "Content-Length: 0", "", ""]).encode())
            await writer.drain()
            writer.close()

        elsewhere = await asyncio.start_server(other, "127.0.0.1", 0)
        front = await asyncio.start_server(redirect, "127.0.0.1", 0)
        async with elsewhere, front:
            url = f"ws://127.0.0.1:{front.sockets[0].getsockname()[1]}/stream"
            headers = {"Authorization": "Bearer secret"}
            with pytest.raises(Unreachable, match="redirected to 'ws://localhost"):
                await AsyncStream.open(url, headers, None, 5.0, proxy=None)

    asyncio.run(main())
    assert received == []


def test_an_observation_without_an_answer_says_that_it_was_the_time() -> None:
    class Silent:
        async def send(self, _message: bytes) -> None:
            """It is received."""

        async def recv(self) -> None:
            await asyncio.Event().wait()

    stream = AsyncStream(Silent())  # type: ignore[arg-type]
    with pytest.raises(Unreachable, match=r"^the stream broke off: TimeoutError\(\)$"):
        asyncio.run(stream.exchange(b"", 0.01))
