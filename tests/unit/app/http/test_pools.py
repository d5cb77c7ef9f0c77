"""Pools of threads, shared fairly between keys."""

import asyncio
import threading
from collections import Counter
from contextlib import ExitStack
from functools import partial

import pytest
from starlette.requests import ClientDisconnect

from app.http.client import Client, require_client
from app.http.errors import ServiceBusy, TooManyRequests
from app.http.pools import Pool, Pools
from app.loading import Loading, NotLoaded
from app.settings import Settings
from core.errors import InvalidMap


class Gate:
    """Work that waits until it is released, and records which calls began."""

    def __init__(self):
        self.began: list[str] = []
        self.most_at_once = Counter[str]()
        self._now = Counter[str]()
        self._lock = threading.Lock()
        self._go = threading.Event()

    def open(self):
        self._go.set()

    def work(self, key):
        def run():
            with self._lock:
                self.began.append(key)
                self._now[key] += 1
                self.most_at_once[key] = max(self.most_at_once[key], self._now[key])
            assert self._go.wait(60)
            with self._lock:
                self._now[key] -= 1
            return key

        return run


async def settled(condition):
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.001)


def test_a_key_never_takes_all_threads_and_another_one_is_let_in_at_once():
    async def run():
        pool, gate = Pool("tests", threads=4, per_key=3, queue=100), Gate()
        greedy = [asyncio.create_task(pool.run("greedy", gate.work("greedy"))) for _ in range(20)]
        await settled(lambda: len(gate.began) == 3)
        other = asyncio.create_task(pool.run("other", gate.work("other")))
        await settled(lambda: len(gate.began) == 4)
        gate.open()
        assert await other == "other"
        assert await asyncio.gather(*greedy) == ["greedy"] * 20
        assert gate.most_at_once == {"greedy": 3, "other": 1}
        assert pool.waiting == 0

    asyncio.run(run())


@pytest.mark.parametrize("of", ["short", "heavy"])
def test_of_the_threads_of_a_service_a_key_leaves_some_to_others(tmp_path, of):
    async def run():
        settings = Settings(
            data_dir=tmp_path, short_threads=4, heavy_threads=4, heavy_threads_per_key=3
        )
        pool, gate = getattr(Pools(settings), of), Gate()
        greedy = [asyncio.create_task(pool.run("greedy", gate.work("greedy"))) for _ in range(8)]
        other = asyncio.create_task(pool.run("other", gate.work("other")))
        await settled(lambda: len(gate.began) == 4)
        gate.open()
        await asyncio.gather(other, *greedy)
        assert gate.most_at_once == {"greedy": 3, "other": 1}

    asyncio.run(run())


def test_keys_that_wait_take_turns():
    async def run():
        pool, gate = Pool("tests", threads=1, per_key=1, queue=100), Gate()
        first = asyncio.create_task(pool.run("a", gate.work("a")))
        await settled(lambda: gate.began == ["a"])
        waiting = []
        for key in "aaabbc":
            waiting.append(asyncio.create_task(pool.run(key, gate.work(key))))
            await asyncio.sleep(0)
        gate.open()
        await asyncio.gather(first, *waiting)
        assert "".join(gate.began) == "a" + "abcaba"

    asyncio.run(run())


def test_above_the_limit_of_waiting_requests_the_key_with_most_is_rejected_first():
    async def run():
        pool, gate = Pool("tests", threads=1, per_key=1, queue=4), Gate()
        tasks = [asyncio.create_task(pool.run("a", gate.work("a"))) for _ in range(3)]
        await settled(lambda: pool.waiting == 2)
        with pytest.raises(TooManyRequests) as rejected:
            await pool.run("a", gate.work("a"))
        assert rejected.value.headers["Retry-After"] == "2"
        tasks += [asyncio.create_task(pool.run("b", gate.work("b"))) for _ in range(2)]
        await settled(lambda: pool.waiting == 4)
        with pytest.raises(ServiceBusy) as busy:
            await pool.run("c", gate.work("c"))
        assert busy.value.headers["Retry-After"] == "2"
        tasks.append(asyncio.create_task(pool.run("a", gate.work("a"), begun=True)))
        await settled(lambda: pool.waiting == 5)
        gate.open()
        await asyncio.gather(*tasks)

    asyncio.run(run())


def test_a_client_that_disconnects_while_it_waits_is_removed_and_the_next_one_is_served():
    async def run():
        pool, gate, client = Pool("tests", threads=1, per_key=1, queue=10), Gate(), Client()
        first = asyncio.create_task(pool.run("a", gate.work("a")))
        await settled(lambda: gate.began == ["a"])
        leaving = asyncio.create_task(pool.run("a", gate.work("left"), client=client))
        cancelled = asyncio.create_task(pool.run("b", gate.work("cancelled")))
        staying = asyncio.create_task(pool.run("b", gate.work("b"), client=Client()))
        await settled(lambda: pool.waiting == 3)
        client.left.set()
        with pytest.raises(ClientDisconnect):
            await leaving
        cancelled.cancel()
        with pytest.raises(asyncio.CancelledError):
            await cancelled
        gate.open()
        assert await first == "a"
        assert await staying == "b"
        assert gate.began == ["a", "b"]
        assert pool.waiting == 0

    asyncio.run(run())


def test_failing_work_returns_its_thread():
    async def run():
        pool = Pool("tests", threads=1, per_key=1, queue=1)

        def fail():
            raise ValueError("as it should")

        for _ in range(3):
            with pytest.raises(ValueError, match="as it should"):
                await pool.run("a", fail)
        assert await pool.run("b", lambda: 7) == 7

    asyncio.run(run())


def test_work_stops_between_two_units_once_its_client_has_left():
    async def run():
        pool, client, units = Pool("tests", threads=1, per_key=1, queue=1), Client(), []
        parts = iter([{"type": "http.request", "more_body": False}])
        disconnected = asyncio.Event()

        async def receive():
            for part in parts:
                return part
            await disconnected.wait()
            return {"type": "http.disconnect"}

        loop = asyncio.get_running_loop()

        def work():
            for unit in range(10**9):
                require_client()
                units.append(unit)
                if unit == 10:
                    loop.call_soon_threadsafe(disconnected.set)

        watching = asyncio.create_task(client.watch(receive))
        with client.waiting(), pytest.raises(ClientDisconnect):
            await pool.run("a", work, client=client)
        await watching
        assert len(units) > 10
        require_client()  # here nobody waits, and nobody left

    asyncio.run(run())


def test_who_waits_for_quiet_waits_for_running_work_and_not_for_ever(monkeypatch):
    async def run():
        pool, gate = Pool("tests", threads=2, per_key=2, queue=100), Gate()
        await pool.quiet()  # nothing runs
        working = asyncio.create_task(pool.run("a", gate.work("a")))
        await settled(lambda: gate.began == ["a"])
        await pool.quiet()
        assert not working.done()
        monkeypatch.setattr("app.http.pools._QUIET_S", 60.0)
        quiet = asyncio.create_task(pool.quiet())
        await asyncio.sleep(0.01)
        assert not quiet.done()
        gate.open()
        await asyncio.wait_for(quiet, 30)
        assert working.done()

    asyncio.run(run())


def test_work_on_the_event_loop_is_one_call_a_turn_and_keys_take_turns():
    async def run():
        pool, order = Pool("tests", threads=1, per_key=1, queue=100), []
        loop_thread = threading.get_ident()

        def work(name):
            assert threading.get_ident() == loop_thread
            order.append(name)
            asyncio.get_running_loop().call_soon(order.append, "all else")
            return name

        keys = ["greedy"] * 4 + ["other"]
        calls = [pool.run_here(key, partial(work, key)) for key in keys]
        assert await asyncio.gather(*calls) == keys
        await asyncio.sleep(0)
        assert order[::2] == ["greedy", "greedy", "other", "greedy", "greedy"]
        assert order[1::2] == ["all else"] * 5
        assert pool.waiting == 0

    asyncio.run(run())


def test_work_on_the_event_loop_that_fails_leaves_room_for_the_next():
    async def run():
        pool = Pool("tests", threads=1, per_key=1, queue=1)
        with pytest.raises(ZeroDivisionError):
            await pool.run_here("a", lambda: 1 // 0)
        assert await pool.run_here("a", lambda: "next") == "next"

    asyncio.run(run())


def test_all_short_work_of_a_key_that_waits_for_one_value_takes_one_heavy_thread_and_no_other():
    async def run():
        pools, gate = Pools(Settings(heavy_threads=2, heavy_threads_per_key=2)), Gate()
        kept: dict[str, str] = {}
        loading = Loading(kept.get)

        def load():
            kept["map"] = gate.work("load")()
            return kept["map"]

        def short(work):
            return pools.when_loaded("key", partial(pools.short.run, "key"), work)

        tasks = [asyncio.create_task(short(lambda: loading.get("map", load))) for _ in range(50)]
        await settled(lambda: gate.began == ["load"])
        assert await pools.heavy.run("key", lambda: "other heavy work") == "other heavy work"
        assert await short(lambda: "short work") == "short work"
        gate.open()
        assert await asyncio.gather(*tasks) == ["load"] * 50
        assert gate.began == ["load"]

    asyncio.run(run())


def short_work_that_loads(pools, gate):
    """Return short work of a key that needs the value `load`, and the keys it was stopped for."""
    kept: dict[str, str] = {}
    loading = Loading(kept.get)
    stopped: list[str] = []

    def load():
        kept["map"] = gate.work("load")()
        return kept["map"]

    async def run(key, work):
        found = await pools.short.run(key, work)
        if isinstance(found, NotLoaded):
            stopped.append(key)
        return found

    def short(key):
        return pools.when_loaded(key, partial(run, key), lambda: loading.get("map", load))

    return short, stopped


def test_short_work_of_several_keys_that_waits_for_one_value_takes_one_heavy_thread():
    async def run():
        pools, gate = Pools(Settings(heavy_threads=2, heavy_threads_per_key=2)), Gate()
        with ExitStack() as ending:
            ending.callback(gate.open)
            short, stopped = short_work_that_loads(pools, gate)
            keys = [f"key {number}" for number in range(6)]
            tasks = [asyncio.create_task(short(key)) for key in keys]
            await settled(lambda: gate.began == ["load"] and sorted(stopped) == keys)
            await settled(asyncio.create_task(pools.heavy.run("other", bool)).done)
            assert pools.heavy.waiting == 0
            gate.open()
            assert await asyncio.gather(*tasks) == ["load"] * 6
            assert gate.began == ["load"]

    asyncio.run(run())


def test_a_load_waits_for_the_heavy_work_of_its_own_key_only():
    async def run():
        settings = Settings(heavy_threads=2, heavy_threads_per_key=1)
        pools, gate, busy = Pools(settings), Gate(), Gate()
        with ExitStack() as ending:
            ending.callback(gate.open)
            ending.callback(busy.open)
            short, stopped = short_work_that_loads(pools, gate)
            scan = asyncio.create_task(pools.heavy.run("busy", busy.work("scan")))
            await settled(lambda: busy.began == ["scan"])
            late = asyncio.create_task(short("busy"))
            await settled(lambda: pools.heavy.waiting == 1)
            early = asyncio.create_task(short("quiet"))
            await settled(lambda: gate.began == ["load"])
            busy.open()
            await scan
            # Now the busy key's load has its turn too, and needs no thread.
            await settled(asyncio.create_task(pools.heavy.run("other", bool)).done)
            gate.open()
            assert [await early, await late] == ["load"] * 2
            assert gate.began == ["load"]
            assert stopped == ["busy", "quiet"]

    asyncio.run(run())


def test_a_key_whose_queue_is_full_does_not_stop_the_load_of_another():
    async def run():
        settings = Settings(heavy_threads=2, heavy_threads_per_key=1, queued_requests=2)
        pools, gate, busy = Pools(settings), Gate(), Gate()
        short, _ = short_work_that_loads(pools, gate)
        scans = [asyncio.create_task(pools.heavy.run("busy", busy.work("scan"))) for _ in range(2)]
        await settled(lambda: pools.heavy.waiting == 1)
        with pytest.raises(TooManyRequests):
            await short("busy")
        gate.open()
        assert await short("quiet") == "load"
        busy.open()
        assert await asyncio.gather(*scans) == ["scan"] * 2

    asyncio.run(run())


def test_short_work_whose_value_cannot_be_loaded_says_why():
    async def run():
        pools = Pools(Settings())
        nothing: dict[str, str] = {}
        loading = Loading(nothing.get)

        def fail():
            raise InvalidMap("it is damaged")

        with pytest.raises(InvalidMap, match="damaged"):
            await pools.when_loaded(
                "key", partial(pools.short.run, "key"), lambda: loading.get("map", fail)
            )

    asyncio.run(run())


# asyncio itself logs it with Python 3.14 and newer, if it is shielded.
def test_a_load_that_fails_when_all_who_waited_have_left_is_not_logged(caplog, collect_own):
    async def run():
        pools, gate = Pools(Settings()), Gate()

        def fail():
            gate.work("load")()
            raise InvalidMap("it is damaged")

        nothing: dict[str, str] = {}
        loading = Loading(nothing.get)
        short = asyncio.create_task(
            pools.when_loaded(
                "key", partial(pools.short.run, "key"), lambda: loading.get("map", fail)
            )
        )
        await settled(lambda: gate.began == ["load"])
        short.cancel()
        with pytest.raises(asyncio.CancelledError):
            await short
        gate.open()
        await settled(asyncio.create_task(pools.heavy.run("other", bool)).done)
        await settled(lambda: asyncio.all_tasks() == {asyncio.current_task()})

    asyncio.run(run())
    collect_own()
    assert not caplog.records
