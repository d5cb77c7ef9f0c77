"""Observations of a track over streams that break, and answers that are lost or late."""

import asyncio
import json
import math
import time
from types import SimpleNamespace
from typing import Any

import pytest
from tensormap_client import Unreachable
from tensormap_client._async import pinned_track
from tensormap_client._async import track as module
from tensormap_client.odometer import Odometer
from tensormap_client.problems import StaleObservation, TooManyRequests

from tests.support.track_service import answered, tracked


@pytest.mark.parametrize("sends_last", [True, False])
def test_after_a_caller_that_stopped_waiting_the_next_scan_has_its_own_answer(sends_last) -> None:
    async def main() -> None:
        service, track = tracked()
        service.sends_last = sends_last
        for _ in range(2):
            await answered(track, travelled_m=1.0)
        service.waiting = asyncio.Event()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(track.observe([], travelled_m=1.0), 0.02)
        service.waiting = None
        assert (await answered(track, travelled_m=1.0)).sequence == 4
        assert service.sent[1:] == [(2, 1.0), (3, 1.0), (4, 1.0)]

    asyncio.run(main())


@pytest.mark.parametrize("says", ["hello", "[1]", "3", "{}"])
def test_what_no_service_says_on_a_stream_is_a_failure_as_of_a_request(says) -> None:
    async def main() -> None:
        service, track = tracked()
        service.says = says
        assert await track.observe([]) is None
        assert isinstance(track.failure, Unreachable)
        assert "no TensorMap service" in str(track.failure)

    asyncio.run(main())


def test_a_problem_of_a_stream_says_how_long_to_wait() -> None:
    async def main() -> None:
        service, track = tracked()
        limited = {"type": "/problems/too-many-requests", "status": 429, "detail": "wait"}
        service.says = json.dumps(limited | {"retry_after_s": 7})
        assert await track.observe([]) is None
        assert isinstance(track.failure, TooManyRequests)
        assert track.failure.retry_after_s == 7.0

    asyncio.run(main())


def test_an_observation_whose_answer_was_lost_is_not_sent_again() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.loses = True
        assert (await answered(track)).sequence == 2
        assert [sequence for sequence, _ in service.sent] == [1, 2]

    asyncio.run(main())


@pytest.mark.parametrize(
    ("lost", "sends_last"), [("loses", True), ("loses", False), ("is_stale", True)]
)
def test_odometry_is_not_counted_twice_if_the_last_observation_cannot_be_had(
    lost, sends_last, monkeypatch
) -> None:
    monkeypatch.setattr(module, "_FIRST_WAIT_S", 0.0)

    async def main() -> None:
        service, track = tracked()
        service.sends_last = sends_last
        await answered(track, travelled_m=1.0)
        setattr(service, lost, True)
        service.breaks, service.get_fails = lost == "is_stale", True
        assert await track.observe([], travelled_m=1.0) is None
        service.is_stale = False
        assert (await answered(track, travelled_m=1.0)).sequence == 3
        assert service.sent[1:] == [(2, 1.0), (3, 1.0)]

    asyncio.run(main())


def test_an_observation_that_the_service_took_meanwhile_is_not_rejected() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.breaks, service.is_stale = True, True
        assert (await answered(track)).sequence == 2

    asyncio.run(main())


def test_an_observation_that_is_stale_and_was_not_taken_is_rejected() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.breaks, service.is_stale, service.receives = True, True, False
        with pytest.raises(StaleObservation, match="it has it"):
            await track.observe([])

    asyncio.run(main())


def test_an_answer_to_another_observation_is_not_that_of_this_one() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.repeats = True
        assert (await answered(track)).sequence == 2
        assert [sequence for sequence, _ in service.sent] == [1, 2]

    asyncio.run(main())


@pytest.mark.parametrize("resets", [False, True])
def test_odometry_is_not_counted_twice_if_the_service_was_at_work_when_the_stream_was_opened_again(
    monkeypatch, resets
) -> None:
    monkeypatch.setattr(module, "_FIRST_WAIT_S", 0.0)

    async def main() -> None:
        service, track = tracked()
        for _ in range(2):
            await answered(track, travelled_m=1.0)
        service.is_late, service.resets, service.refuses = True, resets, resets
        assert await track.observe([], travelled_m=1.0) is None
        for _ in range(2):
            await answered(track, travelled_m=1.0)
        third, fourth, fifth = service.sent[2:]
        assert (third, fifth) == ((3, 1.0), (5, 1.0))
        assert fourth[0] == 4
        assert math.isnan(fourth[1])

    asyncio.run(main())


@pytest.mark.parametrize(("away_s", "travelled_m"), [(0.0, None), (6.0, 2.0)])
def test_odometry_of_an_outage_is_sent_once_the_service_cannot_be_at_work_on_what_was_lost(
    monkeypatch, away_s, travelled_m
) -> None:
    monkeypatch.setattr(module, "_FIRST_WAIT_S", 0.0)

    async def main() -> None:
        service, track = tracked()
        await answered(track, travelled_m=1.0)
        service.breaks, service.refuses = True, True
        assert await track.observe([], travelled_m=1.0) is None
        later = SimpleNamespace(monotonic=lambda: time.monotonic() + away_s)
        monkeypatch.setattr(pinned_track, "time", later)
        assert (await answered(track, travelled_m=1.0)).sequence == 3
        [(number, sent_m)] = service.sent[1:]
        assert number == 3
        assert sent_m == travelled_m or (travelled_m is None and math.isnan(sent_m))

    asyncio.run(main())


def test_a_stream_is_opened_again_with_another_key_and_no_scan_is_lost_or_sent_twice() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track, travelled_m=1.0)
        service.waiting = asyncio.Event()
        observing = asyncio.create_task(answered(track, travelled_m=1.0))
        for _ in range(3):
            await asyncio.sleep(0.0)
        service.key_changes += 1  # while an observation is on its way
        service.waiting.set()
        assert (await observing).sequence == 2
        assert service.opened == 1
        for sequence in (3, 4):
            assert (await answered(track, travelled_m=1.0)).sequence == sequence
        assert service.opened == 2
        assert service.sent[1:] == [(2, 1.0), (3, 1.0), (4, 1.0)]

    asyncio.run(main())


def test_a_scan_is_encoded_again_for_the_same_basis_with_other_parameters() -> None:
    async def encode(points, basis, tilt) -> bytes:
        return bytes(basis.parameters["ranks"])

    def basis_of(ranks) -> Any:
        return SimpleNamespace(digest="0" * 64, parameters={"ranks": ranks}, least_cells=0)

    async def main() -> None:
        sent = pinned_track.AsyncSent(1, None, [], None, encode, Odometer())
        messages = [await sent.message(basis_of(ranks), None) for ranks in ([6, 7], [5, 9])]
        assert [message[25:] for message in messages] == [b"\x06\x07", b"\x05\x09"]

    asyncio.run(main())
