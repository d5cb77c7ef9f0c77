"""A service that has tracks and loses what a test takes from it, and a client's track of it."""

import asyncio
import json
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tensormap_client import ClientError, TrackAnswer, Unreachable
from tensormap_client._async.track import AsyncTrack
from tensormap_client.problems import TrackNotFound

GONE = TrackNotFound("404", 404, "track-not-found", "it is gone")


class Basis:
    """What a track uses of a basis: its digest and parameters, and how many cells a scan needs."""

    parameters: Mapping[str, object] = MappingProxyType({})

    def __init__(self, digest: str) -> None:
        self.digest = digest
        self.least_cells = {"second": 300}.get(digest, 100)


class TrackService:
    """A service that has tracks in two revisions, and loses what a test takes from it."""

    def __init__(self) -> None:
        self.live = "first"
        self.tracks: dict[str, dict[str, Any]] = {}
        self.made = self.opened = 0  # tracks, streams
        self.key_changes = 0
        self.downloading: asyncio.Event | None = None  # until when a basis takes
        self.creating: asyncio.Event | None = None  # until when the answer of a new track takes
        self.lost_with: Exception | None = None  # the answers of new tracks, by this
        self.unknown: set[str] = set()  # revisions in which no place is known
        self.without_basis: dict[str, ClientError] = {}
        self.refused: ClientError | None = None
        self.get_fails = False  # the next request of the last answer
        self.sent: list[tuple[int, float]] = []
        self.waiting: asyncio.Event | None = None
        self.breaks = False  # the next exchange, before it is received
        self.loses = False  # the next answer
        self.is_late = False  # with the next answer: it observes when the next one is sent
        self.resets = False  # the connection of the late answer; else the client waits for it
        self.refuses = False  # the next stream
        self.late: tuple[dict[str, Any], bytes] | None = None
        self.is_stale = False  # every observation, though it is received
        self.receives = True  # observations that are answered to be stale
        self.repeats = False  # the answer before, in place of the next one
        self.sends_last = True  # its number, when a stream is opened
        self.says: str | None = None  # in place of an answer

    async def get(self, revision: str, _patience_s: float) -> Basis:
        if revision in self.without_basis:
            raise self.without_basis[revision]
        if self.downloading is not None:
            await self.downloading.wait()
        return Basis(revision)

    async def json(self, method: str, path: str, **_options: Any) -> Mapping[str, Any]:
        if method == "POST":
            if self.refused is not None:
                raise self.refused
            self.made += 1
            self.tracks[str(self.made)] = {"revision": self.live, "last": None, "observations": 0}
            made = {"track": str(self.made), "revision": self.live}
            if self.creating is not None:
                await self.creating.wait()
            if self.lost_with is not None:
                raise Unreachable("the answer was lost") from self.lost_with
            return made
        if self.get_fails:
            self.get_fails = False
            raise Unreachable("the connection was reset")
        return {"last": self._track(path.rpartition("/")[2])["last"]}

    async def request(self, _method: str, path: str, **_options: Any) -> None:
        self._track(path.rpartition("/")[2])
        del self.tracks[path.rpartition("/")[2]]

    def require_open(self) -> None:
        """Reject nothing: no test closes it."""

    async def stream(self, path: str) -> "TrackStream":
        name = path.split("/")[-2]
        self._track(name)
        if self.refuses:
            self.refuses = False
            raise Unreachable("the connection was refused")
        self.opened += 1
        return TrackStream(self, name)

    def _track(self, name: str) -> dict[str, Any]:
        if name not in self.tracks:
            raise GONE
        return self.tracks[name]


class TrackStream:
    """A stream of one of its tracks."""

    def __init__(self, service: TrackService, track: str) -> None:
        self._service, self._name = service, track
        self._answers: list[str] = []
        last = service.tracks[track]["last"]
        known = {"TensorMap-Last-Sequence": "none" if last is None else str(last["sequence"])}
        self.headers = known if service.sends_last else {}

    async def exchange(self, message: bytes, _timeout_s: float) -> str:
        if self._name not in self._service.tracks or self._service.breaks:
            self._service.breaks = False
            raise Unreachable("the stream broke off")
        track = self._service.tracks[self._name]
        if self._service.is_late:
            self._service.is_late, self._service.late = False, (track, message)
            cause = ConnectionResetError() if self._service.resets else TimeoutError()
            raise Unreachable("the stream broke off") from cause
        if self._service.late is not None:
            self._observed(*self._service.late)
            self._service.late = None
        before = json.dumps(track["last"])
        if self._service.receives:
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


def tracked(encode=_encode) -> tuple[TrackService, AsyncTrack]:
    """Return a service and a client's track of it."""
    service = TrackService()
    return service, AsyncTrack(service, service, "/v1/maps/campus", encode, 5.0)  # type: ignore[arg-type]


async def answered(track: AsyncTrack, travelled_m: float | None = None) -> TrackAnswer:
    """Return the answer to the next scan."""
    answer = await track.observe([], travelled_m=travelled_m)
    assert answer is not None
    return answer
