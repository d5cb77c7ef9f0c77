"""Tracks of a vehicle over a service that is away, loses tracks, or has a new revision."""

import asyncio
import math
import random
from types import SimpleNamespace
from typing import Any

import pytest
from tensormap_client import (
    ClientClosed,
    InvalidArgument,
    TooFewCells,
    Unreachable,
    UnsupportedMap,
    UnusableScan,
)
from tensormap_client._async import track as module
from tensormap_client._async.track import AsyncTrack
from tensormap_client.problems import PROBLEMS

from tests.support.track_service import Basis, TrackService, answered, tracked

LIMITED = PROBLEMS["too-many-tracks"]


def test_a_closed_track_is_an_error_and_no_new_track() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        for _ in range(2):
            await track.close()
        with pytest.raises(ClientClosed, match="the track is closed: make another one"):
            await track.observe([])
        assert (service.made, service.tracks) == (1, {})

    asyncio.run(main())


@pytest.mark.parametrize("name", ["timestamp_s", "travelled_m"])
def test_a_time_or_distance_that_is_no_number_is_named(name) -> None:
    _, track = tracked()
    wrong: list[Any] = ["x", math.nan]
    for value in wrong:
        with pytest.raises(InvalidArgument, match=f"{name} is .*, wanted a number"):
            asyncio.run(track.observe([], **{name: value}))


@pytest.mark.parametrize(("name", "most"), [("timestamp_s", 1e11), ("travelled_m", 1e6)])
def test_a_time_or_distance_that_no_service_takes_is_not_added_to_the_next(name, most) -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track, travelled_m=1.0)
        numbers: list[Any] = [1.001 * most, -1.001 * most, math.inf]
        for wrong in numbers:
            with pytest.raises(InvalidArgument, match=f"{name} is .*, wanted a number from -1e"):
                await track.observe([], **{name: wrong})
        await answered(track, travelled_m=1.0)
        assert service.sent[1:] == [(2, 1.0)]

    asyncio.run(main())


@pytest.mark.parametrize("error", [UnsupportedMap("newer"), Unreachable("away")])
def test_a_revision_without_a_usable_basis_costs_no_answer_and_leaves_no_track(error) -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.live, service.without_basis = "second", {"second": error}
        revisions = {(await answered(track)).revision for _ in range(5)}
        assert (revisions, list(service.tracks)) == ({"first"}, ["1"])
        assert service.made == 2  # it is not tried with each scan

    asyncio.run(main())


def test_a_scan_that_only_the_next_revision_cannot_use_isanswered() -> None:
    async def encode(_points: object, basis: Basis, _tilt: object) -> bytes:
        if basis.digest == "second":
            raise UnusableScan("nothing of it is in the map's image")
        return b"signature"

    async def main() -> None:
        service, track = tracked(encode)
        await answered(track)
        service.live = "second"
        assert (await answered(track)).revision == "first"

    asyncio.run(main())


def test_a_covered_scan_is_not_sent_and_its_odometry_counts_with_the_next() -> None:
    async def encode(points: Any, _basis: object, _tilt: object) -> bytes:
        if not points:
            raise TooFewCells("too few returns")
        return b"signature"

    async def main() -> None:
        service, track = tracked(encode)
        await track.observe([1], travelled_m=1.0)
        for _ in range(2):
            with pytest.raises(TooFewCells):
                await track.observe([], travelled_m=2.0)
        answer = await track.observe([1], travelled_m=1.0)
        assert answer is not None
        assert (answer.sequence, answer.observations) == (4, 2)
        assert service.sent[1:] == [(4, 5.0)]

    asyncio.run(main())


def test_the_revision_that_becomes_live_may_want_more_cells_with_the_same_basis() -> None:
    class SameBasis(TrackService):
        async def get(self, revision: str, patience_s: float) -> Basis:
            basis = await super().get(revision, patience_s)
            basis.digest = "same"
            return basis

    async def encode(points: Any, basis: Basis, _tilt: object) -> bytes:
        if points[0] < basis.least_cells:
            raise TooFewCells("too few returns")
        return b"signature"

    async def main() -> None:
        service = SameBasis()
        track = AsyncTrack(service, service, "/v1/maps/campus", encode, 5.0)  # type: ignore[arg-type]
        await track.observe([200])
        service.live = "second"
        answer = await track.observe([200])
        assert answer is not None
        assert answer.revision == "first"
        assert service.tracks["2"]["observations"] == 0

    asyncio.run(main())


def test_the_track_of_a_revision_that_was_live_for_a_while_is_removed() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.live, service.unknown = "second", {"second"}
        await answered(track)
        assert len(service.tracks) == 2
        service.live = "first"
        assert (await answered(track)).revision == "first"
        assert list(service.tracks) == ["1"]

    asyncio.run(main())


def test_a_vehicle_that_was_away_during_a_hand_over_begins_a_new_track() -> None:
    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.live, service.unknown = "second", {"second"}
        await answered(track)
        assert len(service.tracks) == 2
        service.tracks.clear()
        service.unknown.clear()
        assert (await answered(track)).revision == "second"

    asyncio.run(main())


def test_a_successor_that_the_service_lost_is_replaced(monkeypatch) -> None:
    monkeypatch.setattr(module, "_HAND_OVER_WAIT_S", 0.0)

    async def main() -> None:
        service, track = tracked()
        await answered(track)
        service.live, service.unknown = "second", {"second"}
        await answered(track)
        del service.tracks["2"]
        service.unknown.clear()
        assert [(await answered(track)).revision for _ in range(2)] == ["first", "second"]
        assert list(service.tracks) == ["3"]

    asyncio.run(main())


@pytest.mark.parametrize(
    ("asked_s", "least_s", "most_s"), [(8.0, 8.0, 12.0), (20.0, 20.0, 30.0), (3600.0, 20.0, 30.0)]
)
def test_it_waits_for_as_long_as_the_service_asks_and_at_most_half_a_minute(
    monkeypatch, asked_s, least_s, most_s
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    async def main(share: float) -> None:
        monkeypatch.setattr(random, "uniform", lambda low, high: low + share * (high - low))
        service, track = tracked()
        service.refused = LIMITED("429", 429, "too-many-tracks", "later", retry_after_s=asked_s)
        assert await track.observe([]) is None
        assert track.failure is service.refused
        service.refused = None
        wait_s = least_s + share * (most_s - least_s)
        now_s[0] += 0.99 * wait_s
        assert await track.observe([]) is None
        now_s[0] += 0.02 * wait_s
        await answered(track)

    for share in (0.0, 1.0):
        asyncio.run(main(share))
