"""Tracks of which the answer is late or lost, and callers that stop waiting for one."""

import asyncio
import random
from types import SimpleNamespace

import httpx2
import pytest
from tensormap_client import Unreachable
from tensormap_client._async import track as track_module
from tensormap_client._async import track_maker
from tensormap_client._async.track import AsyncTrack
from tensormap_client.errors import UnreachableByProxy

from tests.support.track_service import TrackService, answered, tracked


class Clock:
    """The clock of tracks, which a test moves; their waits are as long as they may be."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    for module in (track_module, track_maker):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=clock.monotonic))
    monkeypatch.setattr(random, "uniform", lambda _low, high: high)
    return clock


async def given_up(track: AsyncTrack, scans: int = 1) -> None:
    """Pass scans whose caller stops waiting as soon as the service has work."""
    for _ in range(scans):
        observing = asyncio.create_task(track.observe([]))
        for _ in range(5):
            await asyncio.sleep(0.0)
        observing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await observing


@pytest.mark.parametrize("slow", ["creating", "downloading"])
def test_a_track_that_a_caller_stopped_waiting_for_is_that_of_the_next_scan(slow) -> None:
    async def main() -> None:
        service, track = tracked()
        until = asyncio.Event()
        setattr(service, slow, until)
        await given_up(track, scans=5)
        until.set()
        assert (await answered(track)).sequence == 6
        assert (service.made, list(service.tracks)) == (1, ["1"])

    asyncio.run(main())


@pytest.mark.parametrize("slow", ["creating", "downloading"])
def test_a_track_that_nobody_waits_for_is_removed_by_close(slow) -> None:
    async def main() -> None:
        service, track = tracked()
        until = asyncio.Event()
        setattr(service, slow, until)
        await given_up(track, scans=5)
        closing = asyncio.create_task(track.close())
        await asyncio.sleep(0.0)
        until.set()
        await closing
        await track.close()
        assert (service.made, service.tracks) == (1, {})

    asyncio.run(main())


def test_a_track_that_is_closed_while_a_scan_waits_for_it_is_removed() -> None:
    async def main() -> None:
        service, track = tracked()
        until = asyncio.Event()
        service.creating = until
        observing = asyncio.create_task(answered(track))
        for _ in range(5):
            await asyncio.sleep(0.0)
        closing = asyncio.create_task(track.close())
        await asyncio.sleep(0.0)
        until.set()
        await asyncio.gather(observing, closing)
        assert (service.made, service.tracks) == (1, {})

    asyncio.run(main())


def test_a_caller_that_stops_waiting_in_the_moment_of_the_answer_loses_no_track() -> None:
    async def main() -> None:
        service, track = tracked()
        service.creating = asyncio.Event()
        observing = asyncio.create_task(track.observe([]))
        await asyncio.sleep(0.0)
        making = track._maker._making
        await asyncio.sleep(0.0)
        assert making._task is not None
        making._task.add_done_callback(lambda _: observing.cancel())
        service.creating.set()
        with pytest.raises(asyncio.CancelledError):
            await observing
        await answered(track)
        assert (service.made, list(service.tracks)) == (1, ["1"])

    asyncio.run(main())


def test_a_track_that_was_made_for_an_earlier_scan_and_is_gone_is_replaced() -> None:
    async def main() -> None:
        service, track = tracked()
        service.creating = asyncio.Event()
        await given_up(track)
        service.creating.set()
        for _ in range(9):
            await asyncio.sleep(0.0)
        service.tracks.clear()  # it was idle for too long
        await answered(track)
        assert list(service.tracks) == ["2"]

    asyncio.run(main())


def test_a_track_of_an_event_loop_that_ended_is_made_anew_in_another() -> None:
    service, track = tracked()

    async def stop() -> None:
        service.creating = asyncio.Event()
        await given_up(track)

    async def go_on() -> None:
        service.creating = None
        await answered(track)

    asyncio.run(stop())
    asyncio.run(go_on())
    assert service.made == 2


def test_a_failure_that_nobody_waited_for_is_that_of_the_next_scan() -> None:
    async def main() -> None:
        service, track = tracked()
        service.creating, service.lost_with = asyncio.Event(), httpx2.ReadTimeout("late")
        await given_up(track)
        service.creating.set()
        assert await track.observe([]) is None
        assert isinstance(track.failure, Unreachable)
        await track.close()

    asyncio.run(main())


async def made_in(seconds: float, service: TrackService, track: AsyncTrack, clock: Clock) -> int:
    """Return how many tracks are made meanwhile, by 10 scans a second."""
    for _ in range(round(10 * seconds)):
        await track.observe([])
        clock.now_s += 0.1
    return service.made


@pytest.mark.parametrize(
    "error",
    [
        httpx2.ReadTimeout("late"),
        httpx2.ReadError("reset"),
        httpx2.RemoteProtocolError("Server disconnected without sending a response."),
    ],
)
def test_few_tracks_are_made_while_their_answers_are_lost(clock, error) -> None:
    async def main() -> None:
        service, track = tracked()
        service.lost_with = error
        assert await made_in(0.1, service, track, clock) == 1
        assert isinstance(track.failure, Unreachable)
        assert await made_in(0.5, service, track, clock) == 1
        assert isinstance(track.failure, Unreachable)
        assert await made_in(9.4, service, track, clock) <= 3
        assert await made_in(590.0, service, track, clock) <= 25  # all that are not idle yet
        service.lost_with = None
        clock.now_s += 30.0
        assert (await answered(track)).localized

    asyncio.run(main())


def test_few_tracks_are_made_in_the_next_revision_while_their_answers_are_lost(clock) -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.live, service.lost_with = "second", httpx2.ReadTimeout("late")
        assert await made_in(600.0, service, track, clock) <= 25
        assert (await answered(track)).revision == "first"

    asyncio.run(main())


def test_a_scan_that_waits_for_a_track_reports_the_failure_that_it_waits_after(clock) -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.live, service.lost_with = "second", httpx2.ReadTimeout("late")
        await answered(track)  # that of the first revision, and the next one's track is lost
        assert track.failure is None
        service.tracks.clear()
        assert await track.observe([]) is None
        assert isinstance(track.failure, Unreachable)
        assert track.failure.__cause__ is service.lost_with
        service.lost_with = None
        clock.now_s += 30.0
        await answered(track)
        assert track.failure is None

    asyncio.run(main())


@pytest.mark.parametrize(
    "error", [httpx2.ConnectError("refused"), httpx2.ConnectTimeout(""), httpx2.ProxyError("503")]
)
def test_a_service_that_did_not_get_the_request_is_asked_again_within_a_second(
    clock, error
) -> None:
    async def main() -> None:
        service, track = tracked()
        service.lost_with = error
        assert await made_in(60.0, service, track, clock) > 50
        service.lost_with = None
        clock.now_s += 1.0
        await answered(track)

    asyncio.run(main())


@pytest.mark.parametrize(("status", "is_asked_soon"), [(502, False), (503, True), (504, False)])
def test_a_proxy_that_stopped_waiting_may_have_lost_a_track(clock, status, is_asked_soon) -> None:
    async def main() -> None:
        service, track = tracked()
        service.refused = UnreachableByProxy("a proxy", status, "", "")
        await track.observe([])
        service.refused = None
        clock.now_s += 0.2
        assert (await track.observe([]) is not None) == is_asked_soon

    asyncio.run(main())
