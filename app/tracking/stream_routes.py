"""A track over one WebSocket: observations in, answers out."""

import asyncio
import logging
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from typing import Annotated, NoReturn

from anyio import to_thread
from fastapi import APIRouter, Path, Query, WebSocket, WebSocketDisconnect, status
from fastapi.exceptions import RequestValidationError
from starlette.types import Message

from app.access.access import sent_hash
from app.access.api_router import api_router
from app.access.dependency import stream_caller
from app.access.scopes import Scope, needs
from app.http import errors
from app.http.answer_forms import Form
from app.http.answer_headers import LAST_SEQUENCE, headed
from app.http.bodies.json_body import SMALL_BYTES
from app.http.context import context_of, logged_path
from app.http.problems import (
    invalid_response,
    is_failure,
    log_failure,
    problem_response,
    problems,
)
from app.http.query_names import QueryNames
from app.outage import Outage
from app.quick_work import NotQuick
from app.service import Service
from app.tracking.answers import STEP, STREAM_PROTOCOL, form_of
from app.tracking.routes import TrackId, take_observation, track_of
from app.tracking.stream_messages import problem_message, read_observation
from core.errors import TensorMapError
from core.tracking.track import Observation
from storage.errors import MapNotFound, RevisionNotFound

_log = logging.getLogger("tensormap.tracks")

router = APIRouter(tags=["tracks"], prefix="/v1")
elsewhere = APIRouter()
without_upgrade = api_router(tags=["tracks"], dependencies=(needs(Scope.LOCALIZE),))
# Any text: whether there is such a map and track is checked when the stream is opened.
_Map = Annotated[str, Path(alias="map", description="The map's name.")]
_Fields = Annotated[
    str | None, Query(description="The fields to answer with, as of `POST .../observations`.")
]
_PATH = "/maps/{map}/tracks/{track}/stream"

_ENDING = (
    errors.TrackNotFound,
    MapNotFound,
    RevisionNotFound,
    errors.HostNotAllowed,
    errors.KeyNeeded,
    errors.KeyRefused,
    errors.ScopeMissing,
)


@without_upgrade.get(
    _PATH,
    status_code=status.HTTP_101_SWITCHING_PROTOCOLS,
    responses={
        101: headed(LAST_SEQUENCE),
        **problems(
            errors.UpgradeRequired,
            errors.TrackNotFound,
            errors.TooManyStreams,
            errors.TooManyStreamsOfKey,
            *errors.REVISION,
            *errors.READING,
        ),
    },
)
async def request_stream(map_slug: _Map, track_id: TrackId, fields: _Fields = None) -> None:
    """Open a WebSocket: observations in, answers out.

    A request without `Upgrade: websocket`, as through a proxy that drops it, is refused.
    """
    del fields  # of the stream's answers: described here
    raise errors.UpgradeRequired(
        f"the request has no 'Upgrade: websocket', the stream of track {track_id[:40]!r} of"
        f" map {map_slug[:64]!r} is a WebSocket: a proxy has to pass Upgrade and Connection on"
    )


@router.websocket(_PATH)
async def stream(
    websocket: WebSocket,
    map_slug: _Map,
    track_id: TrackId,
    fields: _Fields = None,
) -> None:
    """Answer each observation.

    A binary message is packed signatures, after number, time and odometry or without; a text
    message is the JSON of `ObservationIn`. A refused observation is answered with the problem that
    HTTP would return, and the stream stays open. It is closed if the track was removed or the key
    revoked, which is checked with each message, and if no message comes for a time.

    An answer is text, the JSON of `TrackStepOut` or of `fields`; to a client that offers the
    subprotocol `STREAM_PROTOCOL` it is packed, a binary message. Problems are text.

    `TensorMap-Last-Sequence` in the answer that opens it is the number of the track's last
    observation that had one: a vehicle that comes back need not ask for it.
    """
    service: Service = websocket.app.state.service
    with ExitStack() as counted:
        opening = partial(to_thread.run_sync, limiter=service.pools.opening)
        check = partial(_open, websocket, service, map_slug, counted)
        try:
            service.streams.require_room(sent_hash(websocket))
            key_id = await opening(check)
            QueryNames(websocket.scope["route"].dependant).require(websocket.query_params)
            form = _form_of(websocket, fields)
            find = partial(_last_sequence, service, map_slug, track_id)
            last = await service.pools.when_loaded(key_id, opening, find)
        except TensorMapError as error:
            log_failure(_log, f"stream {logged_path(websocket.scope)}", error)
            await websocket.send_denial_response(problem_response(error))
            return
        except RequestValidationError as error:
            await websocket.send_denial_response(invalid_response(error))
            return
        await websocket.accept(
            STREAM_PROTOCOL if form.packed_as else None,
            [(LAST_SEQUENCE.lower().encode(), str(last).encode())],
        )
        opened = _Stream(websocket, service, form, map_slug, track_id, key_id)
        outage = Outage(_log, f"stream {logged_path(websocket.scope)}")
        with suppress(WebSocketDisconnect):
            while True:
                await _answer(opened, outage)


@elsewhere.websocket("/{path:path}")
async def refuse(websocket: WebSocket) -> None:
    """Refuse a WebSocket of another path; by itself Starlette answers 403, as for a wrong key."""
    path = websocket.url.path[:200]
    error = errors.NoSuchRoute(
        f"there is no WebSocket {path}, wanted /v1{_PATH} of a map and its track"
    )
    await websocket.send_denial_response(problem_response(error))


def _form_of(websocket: WebSocket, fields: str | None) -> Form:
    """Return the form of a stream's answers.

    Raises:
        RequestValidationError: If an answer has no such fields.
        InvalidRequest: If packed answers and fields were asked for.
    """
    packed = STREAM_PROTOCOL in websocket.scope["subprotocols"]
    try:
        return form_of(fields, STEP.media_type if packed else None)
    except ValueError as error:
        flaw = {"type": "value_error", "loc": ("query", "fields"), "msg": str(error)}
        raise RequestValidationError([flaw]) from None


@dataclass(frozen=True)
class _Stream:
    """An open stream of a track."""

    websocket: WebSocket
    service: Service
    form: Form
    map_slug: str
    track_id: str
    key_id: str


async def _answer(stream: _Stream, outage: Outage) -> None:
    """Wait for a message and answer it.

    Raises:
        WebSocketDisconnect: If the stream was closed, or is closed with this message.
    """
    websocket = stream.websocket
    received = await _next_message(websocket, stream.service.settings.stream_idle_s)
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code", status.WS_1000_NORMAL_CLOSURE))
    text: str | None = received.get("text")
    body: bytes | str = received.get("bytes") or b"" if text is None else text
    message = _StreamMessage(stream, body)
    try:
        answer = await _answered(message)
    except TensorMapError as error:
        if is_failure(error):
            outage.failed(error)
        await websocket.send_text(problem_message(error, body, message.observation))
        if isinstance(error, errors.BodyTooLarge):
            await _close(websocket, status.WS_1009_MESSAGE_TOO_BIG)
        if isinstance(error, _ENDING):
            await _close(websocket, status.WS_1008_POLICY_VIOLATION)
        return
    outage.over()
    if isinstance(answer, bytes):
        await websocket.send_bytes(answer)
    else:
        await websocket.send_text(answer)


async def _answered(message: "_StreamMessage") -> str | bytes:
    """Return the answer, made without a thread if that takes no longer than the event loop may."""
    service, key_id = message.stream.service, message.stream.key_id
    pools, size = service.pools, len(message.body)
    if size <= SMALL_BYTES:
        with suppress(NotQuick):
            return await pools.at_once(key_id, message.answer, service.store.catalog.kept_only)
    pool = pools.of_observation(size)
    if pool is pools.heavy:
        return await pool.run(key_id, message.answer)
    return await pools.when_loaded(key_id, partial(pool.run, key_id), message.answer)


async def _next_message(websocket: WebSocket, idle_s: float) -> Message:
    try:
        async with asyncio.timeout(idle_s):
            return await websocket.receive()
    except TimeoutError:
        reason = f"no message for {idle_s:g} s"
        await _close(websocket, status.WS_1001_GOING_AWAY, reason)  # the client may reconnect


async def _close(websocket: WebSocket, code: int, reason: str | None = None) -> NoReturn:
    await websocket.close(code, reason)
    raise WebSocketDisconnect(code, reason)


def _open(websocket: WebSocket, service: Service, map_slug: str, counted: ExitStack) -> str:
    """Return the id of the stream's key; the stream counts until `counted` is closed."""
    caller = stream_caller(websocket, Scope.LOCALIZE, map_slug=map_slug)
    counted.enter_context(service.streams.opened(caller.key_id, sent_hash(websocket)))
    return caller.key_id


def _last_sequence(service: Service, map_slug: str, track_id: str) -> int | str:
    """Return the number of the track's last observation that had one."""
    found, _, _ = track_of(service, map_slug, track_id)
    return "none" if found.sequence is None else found.sequence


@dataclass
class _StreamMessage:
    """A message of a track's stream.

    Attributes:
        observation: The observation that it holds, once it is read.
    """

    stream: _Stream
    body: bytes | str
    observation: Observation | None = None
    _admitted: bool = False

    def answer(self) -> str | bytes:
        """Return the answer.

        Raises:
            TensorMapError: If the message is refused.
        """
        stream, service = self.stream, self.stream.service
        sent = len(self.body.encode() if isinstance(self.body, str) else self.body)
        if not self._admitted:
            stream_caller(stream.websocket, Scope.LOCALIZE, map_slug=stream.map_slug)
            self._admitted = True
            service.access.spend_bytes(context_of(stream.websocket.scope), sent, sent)
        limit = service.settings.max_json_bytes
        if sent > limit:
            raise errors.BodyTooLarge(f"the message has {sent} bytes, at most {limit} are read")
        observation = self.observation = read_observation(self.body)
        answer = take_observation(service, stream.map_slug, stream.track_id, lambda _: observation)
        return stream.form.content(answer.shown, answer.packed)
