"""Tracks of a vehicle over a service that is away, loses tracks, or has a new revision."""

import asyncio
import json
import math
import struct
import time
from collections.abc import Mapping
from typing import Any

import pytest
from tensormap_client import (
    ClientClosed,
    ClientError,
    InvalidArgument,
    TooFewCells,
    TrackAnswer,
    Unreachable,
    UnsupportedMap,
    UnusableScan,
)
from tensormap_client._async import track as module
from tensormap_client._async.track import AsyncTrack
from tensormap_client.problems import PROBLEMS, StaleObservation, TrackNotFound

LIMITED = PROBLEMS["too-many-tracks"]
GONE = TrackNotFound("404", 404, "track-not-found", "it is gone")


class Basis:
    def __init__(self, digest: str) -> None:
        self.digest = digest
        self.least_cells = {"second": 300}.get(digest, 100)


class Service:
    """A service that has tracks in two revisions, and loses what a test takes from it."""

    def __init__(self) -> None:
        self.live = "first"
        self.tracks: dict[str, dict[str, Any]] = {}
        self.made = 0
        self.unknown: set[str] = set()  # revisions in which no place is known
        self.without_basis: dict[str, ClientError] = {}
        self.refused: ClientError | None = None
        self.silent = False  # about the last observation, once
        self.sent: list[tuple[int, float]] = []
        self.waiting: asyncio.Event | None = None
        self.breaks = False  # the next exchange, before it is received
        self.loses = False  # the next answer
        self.is_late = False  # with the next answer: it observes when the next one is sent
        self.late: tuple[dict[str, Any], bytes] | None = None
        self.is_stale = False  # every observation, though it is received
        self.takes = True  # what it answers to be stale
        self.repeats = False  # the answer before, in place of the next one
        self.tells = True  # the last sequence, when a stream is opened
        self.says: str | None = None  # in place of an answer

    async def get(self, revision: str, _patience_s: float) -> Basis:
        if revision in self.without_basis:
            raise self.without_basis[revision]
        return Basis(revision)

    async def json(self, method: str, path: str, **_options: Any) -> Mapping[str, Any]:
        if method == "POST":
            if self.refused is not None:
                raise self.refused
            self.made += 1
            self.tracks[str(self.made)] = {"revision": self.live, "last": None, "observations": 0}
            return {"track": str(self.made), "revision": self.live}
        if self.silent:
            self.silent = False
            raise Unreachable("the connection was reset")
        return {"last": self._track(path.rpartition("/")[2])["last"]}

    async def request(self, _method: str, path: str, **_options: Any) -> None:
        self._track(path.rpartition("/")[2])
        del self.tracks[path.rpartition("/")[2]]

    async def stream(self, path: str) -> "Stream":
        name = path.split("/")[-2]
        self._track(name)
        return Stream(self, name)

    def _track(self, name: str) -> dict[str, Any]:
        if name not in self.tracks:
            raise GONE
        return self.tracks[name]


class Stream:
    def __init__(self, service: Service, track: str) -> None:
        self._service, self._name = service, track
        self._answers: list[str] = []
        last = service.tracks[track]["last"]
        told = {"TensorMap-Last-Sequence": "none" if last is None else str(last["sequence"])}
        self.headers = told if service.tells else {}

    async def exchange(self, message: bytes, _timeout_s: float) -> str:
        if self._name not in self._service.tracks or self._service.breaks:
            self._service.breaks = False
            raise Unreachable("the stream broke off")
        track = self._service.tracks[self._name]
        if self._service.is_late:
            self._service.is_late, self._service.late = False, (track, message)
            raise Unreachable("the stream broke off") from TimeoutError()
        if self._service.late is not None:
            self._observed(*self._service.late)
            self._service.late = None
        before = json.dumps(track["last"])
        if self._service.takes:
            self._observed(track, message)
        if self._service.repeats:
            self._service.repeats = False
            return before
        if self._service.is_stale:
            stale = {"type": "/problems/stale-observation", "status": 409, "detail": "it has it"}
            return json.dumps(stale)
        if self._service.loses:
            self._service.loses = False
            raise Unreachable("the stream broke off")
        if self._service.says is not None:
            return self._service.says
        self._answers.append(json.dumps(track["last"]))
        if self._service.waiting is not None:
            await self._service.waiting.wait()
        return self._answers.pop(0)

    def _observed(self, track: dict[str, Any], message: bytes) -> None:
        _, sequence, _, travelled_m = struct.unpack_from("<BQdd", message)
        self._service.sent.append((sequence, travelled_m))
        track["observations"] += 1
        track["last"] = {
            "sequence": sequence,
            "observations": track["observations"],
            "revision": track["revision"],
            "live_revision": self._service.live,
            "localized": track["revision"] not in self._service.unknown,
            "pose": None,
        }

    async def close(self) -> None:
        """Nothing is open."""


async def _encode(_points: object, _basis: object, _tilt: object) -> bytes:
    return b"signature"


def _tracked(encode=_encode) -> tuple[Service, AsyncTrack]:
    service = Service()
    return service, AsyncTrack(service, service, "/v1/maps/campus", encode, 5.0)  # type: ignore[arg-type]


async def _answered(track: AsyncTrack, travelled_m: float | None = None) -> TrackAnswer:
    answer = await track.observe([], travelled_m=travelled_m)
    assert answer is not None
    return answer


@pytest.mark.parametrize("tells", [True, False])
def test_after_a_caller_that_stopped_waiting_the_next_scan_has_its_own_answer(tells) -> None:
    async def main() -> None:
        service, track = _tracked()
        service.tells = tells
        for _ in range(2):
            await _answered(track, travelled_m=1.0)
        service.waiting = asyncio.Event()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(track.observe([], travelled_m=1.0), 0.02)
        service.waiting = None
        assert (await _answered(track, travelled_m=1.0)).sequence == 4
        assert service.sent[1:] == [(2, 1.0), (3, 1.0), (4, 1.0)]

    asyncio.run(main())


@pytest.mark.parametrize("said", ["hello", "[1]", "3", "{}"])
def test_what_no_service_says_on_a_stream_is_a_failure_as_of_a_request(said) -> None:
    async def main() -> None:
        service, track = _tracked()
        service.says = said
        assert await track.observe([]) is None
        assert isinstance(track.failure, Unreachable)
        assert "no TensorMap service" in str(track.failure)

    asyncio.run(main())


def test_a_closed_track_is_an_error_and_no_new_track() -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        for _ in range(2):
            await track.close()
        with pytest.raises(ClientClosed, match="the track is closed: make another one"):
            await track.observe([])
        assert (service.made, service.tracks) == (1, {})

    asyncio.run(main())


@pytest.mark.parametrize("name", ["timestamp_s", "travelled_m"])
def test_a_time_or_distance_that_is_no_number_is_named(name) -> None:
    _, track = _tracked()
    wrong: list[Any] = ["x", math.nan]
    for value in wrong:
        with pytest.raises(InvalidArgument, match=f"{name} is .*, wanted a number"):
            asyncio.run(track.observe([], **{name: value}))


@pytest.mark.parametrize(("name", "most"), [("timestamp_s", 1e11), ("travelled_m", 1e6)])
def test_a_time_or_distance_that_no_service_takes_is_not_added_to_the_next(name, most) -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track, travelled_m=1.0)
        numbers: list[Any] = [1.001 * most, -1.001 * most, math.inf]
        for wrong in numbers:
            with pytest.raises(InvalidArgument, match=f"{name} is .*, wanted a number from -1e"):
                await track.observe([], **{name: wrong})
        await _answered(track, travelled_m=1.0)
        assert service.sent[1:] == [(2, 1.0)]

    asyncio.run(main())


@pytest.mark.parametrize("error", [UnsupportedMap("newer"), Unreachable("away")])
def test_a_revision_without_a_usable_basis_costs_no_answer_and_leaves_no_track(error) -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.live, service.without_basis = "second", {"second": error}
        revisions = {(await _answered(track)).revision for _ in range(5)}
        assert (revisions, list(service.tracks)) == ({"first"}, ["1"])
        assert service.made == 2  # it is not tried with each scan

    asyncio.run(main())


def test_a_scan_that_only_the_next_revision_cannot_use_is_answered() -> None:
    async def encode(_points: object, basis: Basis, _tilt: object) -> bytes:
        if basis.digest == "second":
            raise UnusableScan("nothing of it is in the map's image")
        return b"signature"

    async def main() -> None:
        service, track = _tracked(encode)
        await _answered(track)
        service.live = "second"
        assert (await _answered(track)).revision == "first"

    asyncio.run(main())


def test_a_covered_scan_is_not_sent_and_its_odometry_counts_with_the_next() -> None:
    async def encode(points: Any, _basis: object, _tilt: object) -> bytes:
        if not points:
            raise TooFewCells("too few returns")
        return b"signature"

    async def main() -> None:
        service, track = _tracked(encode)
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
    class SameBasis(Service):
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


def test_a_vehicle_that_was_away_during_a_hand_over_begins_a_new_track() -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.live, service.unknown = "second", {"second"}
        await _answered(track)
        assert len(service.tracks) == 2
        service.tracks.clear()
        service.unknown.clear()
        assert (await _answered(track)).revision == "second"

    asyncio.run(main())


def test_a_successor_that_the_service_lost_is_replaced(monkeypatch) -> None:
    monkeypatch.setattr(module, "_HAND_OVER_WAIT_S", 0.0)

    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.live, service.unknown = "second", {"second"}
        await _answered(track)
        del service.tracks["2"]
        service.unknown.clear()
        assert [(await _answered(track)).revision for _ in range(2)] == ["first", "second"]
        assert list(service.tracks) == ["3"]

    asyncio.run(main())


def test_it_waits_for_as_long_as_the_service_asks(monkeypatch) -> None:
    async def main() -> None:
        service, track = _tracked()
        service.refused = LIMITED("429", 429, "too-many-tracks", "later", retry_after_s=60.0)
        assert await track.observe([]) is None
        assert track.failure is service.refused
        service.refused = None
        late_s = time.monotonic() + 50.0
        monkeypatch.setattr(time, "monotonic", lambda: late_s)
        assert await track.observe([]) is None

    asyncio.run(main())


def test_an_observation_whose_answer_was_lost_is_not_sent_again() -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.loses = True
        assert (await _answered(track)).sequence == 2
        assert [sequence for sequence, _ in service.sent] == [1, 2]

    asyncio.run(main())


@pytest.mark.parametrize(("lost", "tells"), [("loses", True), ("loses", False), ("is_stale", True)])
def test_odometry_is_not_counted_twice_if_the_last_observation_cannot_be_had(
    lost, tells, monkeypatch
) -> None:
    monkeypatch.setattr(module, "_FIRST_WAIT_S", 0.0)

    async def main() -> None:
        service, track = _tracked()
        service.tells = tells
        await _answered(track, travelled_m=1.0)
        setattr(service, lost, True)
        service.breaks, service.silent = lost == "is_stale", True
        assert await track.observe([], travelled_m=1.0) is None
        service.is_stale = False
        assert (await _answered(track, travelled_m=1.0)).sequence == 3
        assert service.sent[1:] == [(2, 1.0), (3, 1.0)]

    asyncio.run(main())


def test_an_observation_that_the_service_took_meanwhile_is_not_rejected() -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.breaks, service.is_stale = True, True
        assert (await _answered(track)).sequence == 2

    asyncio.run(main())


def test_an_observation_that_is_stale_and_was_not_taken_is_rejected() -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.breaks, service.is_stale, service.takes = True, True, False
        with pytest.raises(StaleObservation, match="it has it"):
            await track.observe([])

    asyncio.run(main())


def test_an_answer_to_another_observation_is_not_that_of_this_one() -> None:
    async def main() -> None:
        service, track = _tracked()
        await _answered(track)
        service.repeats = True
        assert (await _answered(track)).sequence == 2
        assert [sequence for sequence, _ in service.sent] == [1, 2]

    asyncio.run(main())


def test_odometry_is_not_counted_twice_if_the_service_was_at_work_when_the_stream_was_opened_again(
    monkeypatch,
) -> None:
    monkeypatch.setattr(module, "_FIRST_WAIT_S", 0.0)

    async def main() -> None:
        service, track = _tracked()
        for _ in range(2):
            await _answered(track, travelled_m=1.0)
        service.is_late = True
        assert await track.observe([], travelled_m=1.0) is None
        for _ in range(2):
            await _answered(track, travelled_m=1.0)
        third, fourth, fifth = service.sent[2:]
        assert (third, fifth) == ((3, 1.0), (5, 1.0))
        assert fourth[0] == 4
        assert math.isnan(fourth[1])

    asyncio.run(main())
