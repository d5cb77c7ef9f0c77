"""The events of jobs, while the catalog does not answer."""

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

from app.jobs.events import JobEvents, event_id


def test_a_stop_does_not_wait_for_a_read_of_followed_jobs_that_hangs() -> None:
    reached, released = threading.Event(), threading.Event()

    def hang(_: object) -> dict[str, Any]:
        reached.set()
        released.wait(60.0)
        return {}

    async def follow() -> None:
        store: Any = SimpleNamespace(jobs=SimpleNamespace(with_ids=hang))
        access: Any = SimpleNamespace(caller_of=lambda _: None)
        events = JobEvents(store, access)
        job: Any = SimpleNamespace(id="a", state="running", stage="", done_units=0, total_units=1)
        job.ended = False
        connection: Any = SimpleNamespace(headers={})
        stream = events.follow(connection, job, event_id(job))
        following = asyncio.ensure_future(anext(stream))
        while not reached.is_set():
            await asyncio.sleep(0.01)
        assert not following.done()

    looping = threading.Thread(target=lambda: asyncio.run(follow()), daemon=True)
    looping.start()
    assert reached.wait(20.0)
    looping.join(5.0)
    ended = not looping.is_alive()
    released.set()
    looping.join(20.0)
    assert ended


def test_followers_are_released_at_the_end_and_none_follows_later() -> None:
    job: Any = SimpleNamespace(id="a", state="running", stage="", done_units=0, total_units=1)
    job.ended = False
    store: Any = SimpleNamespace(jobs=SimpleNamespace(with_ids=lambda _: {"a": job}))
    access: Any = SimpleNamespace(caller_of=lambda _: None)
    connection: Any = SimpleNamespace(headers={})

    async def follow() -> list[list[bytes]]:
        events = JobEvents(store, access)

        async def followed() -> list[bytes]:
            return [event async for event in events.follow(connection, job, event_id(job))]

        following = asyncio.ensure_future(followed())
        await asyncio.sleep(0)
        events.end()
        return [await following, await followed()]

    assert asyncio.run(asyncio.wait_for(follow(), 20.0)) == [[], []]
