"""Spooled bodies, their minimum rate, and the cost of JSON."""

import asyncio
import errno
import json
import shutil
import threading

import pytest
from anyio import CapacityLimiter
from fastapi.exceptions import RequestValidationError
from starlette.requests import ClientDisconnect

from app.drives.pose_schemas import PosesIn
from app.http.bodies.content_digest import ContentDigest
from app.http.bodies.incoming import Incoming, Pace
from app.http.bodies.json_body import MOST_DEPTH, MOST_KEYS, MOST_VALUES, read_json
from app.http.bodies.spool import _SHARED_BYTES, _SMALL_BYTES, Spool, SpoolRoom
from app.http.errors import BodyTooLarge, InvalidRequest, ServiceBusy, SlowBody, TooManyRequests
from app.maps.schemas import MapIn
from app.settings import Settings
from storage.errors import StorageFull

CHUNK = bytes(range(256)) * 256  # 64 KiB, as they come from a socket


def room_in(folder, **settings):
    return SpoolRoom(Settings(data_dir=folder, **settings), CapacityLimiter(1))


async def filled(room, key, chunks):
    spool = Spool(room, key)
    for _ in range(chunks):
        await spool.write(CHUNK)
    return spool


@pytest.mark.parametrize("chunks", [0, 1, 3, 100, 200])
def test_a_spool_returns_its_content_any_number_of_times(tmp_path, chunks):
    async def run():
        spool = await filled(room_in(tmp_path), "a", chunks)
        assert len(spool) == chunks * len(CHUNK)
        for _ in range(2):
            assert b"".join(spool.pieces()) == CHUNK * chunks
        await spool.write(b"more")
        assert b"".join(spool.pieces()) == CHUNK * chunks + b"more"
        spool.clear()
        assert b"".join(spool.pieces()) == b""
        assert not list(tmp_path.iterdir())  # its file has no name

    asyncio.run(run())


def test_a_spool_whose_reader_stopped_early_still_grows_at_its_end(tmp_path):
    async def run():
        room = room_in(tmp_path)
        assert room.lend(_SHARED_BYTES)  # to other bodies: this one is in its file
        spool = await filled(room, "a", 64)
        assert next(spool.pieces()) == CHUNK * 16
        for _ in range(16):
            await spool.write(CHUNK[::-1])
        assert b"".join(spool.pieces()) == CHUNK * 64 + CHUNK[::-1] * 16
        spool.clear()

    asyncio.run(run())


@pytest.mark.parametrize("length", [1, 700, 20_000])
def test_a_body_in_small_chunks_takes_little_more_memory_than_it_has(tmp_path, length):
    async def run():
        spool, body = Spool(room_in(tmp_path), "a"), CHUNK + CHUNK[::-1][: 40 * length % 2**16]
        for begin in range(0, len(body), length):
            await spool.write(body[begin : begin + length])
        await spool.write(b"")
        pieces = list(spool.pieces())
        assert b"".join(pieces) == body
        assert len(pieces) <= 1 + 2 * len(body) / 2**14

    asyncio.run(run())


class Filling:
    """A file on a disk that takes half of the next bytes, and no more."""

    def __init__(self, file):
        self._file, self._writes = file, 0

    def write(self, content):
        self._writes += 1
        if self._writes > 1:
            raise OSError(errno.ENOSPC, "no space")
        return self._file.write(content[: len(content) // 2])

    def __getattr__(self, name):
        return getattr(self._file, name)


def test_a_full_disk_causes_no_repeated_bytes(tmp_path):
    async def run():
        spool = await filled(room_in(tmp_path), "a", 200)
        await spool.write(b"x" * 2**20)
        spool._file = Filling(spool._file)
        with pytest.raises(StorageFull):
            await spool.write(CHUNK * 200)
        spool._file = spool._file._file
        came = b"".join(spool.pieces())
        assert (CHUNK * 200 + b"x" * 2**20 + CHUNK * 200).startswith(came)
        spool.clear()

    asyncio.run(run())


def test_a_disk_is_not_filled_by_bodies(tmp_path, monkeypatch):
    total = 2**34
    usage = shutil.disk_usage(tmp_path)._replace(total=total, free=total // 40)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

    async def run():
        spool = Spool(room_in(tmp_path), "a")
        with pytest.raises(StorageFull, match="kept free"):
            await spool.write(CHUNK * 200)
        spool.clear()

    asyncio.run(run())


def test_many_bodies_together_stay_out_of_memory(tmp_path):
    async def run():
        room = room_in(tmp_path)
        spools = [await filled(room, "a", 8) for _ in range(200)]
        held = sum(len(chunk) for spool in spools for chunk in spool._memory)
        assert 0 < held <= _SHARED_BYTES + len(spools) * _SMALL_BYTES
        for spool in spools:
            assert b"".join(spool.pieces()) == CHUNK * 8
            spool.clear()
        again = await filled(room, "a", 100)
        assert again._file is None  # the shared memory was returned
        again.clear()

    asyncio.run(run())


def test_a_key_takes_three_quarters_of_the_room_and_gives_it_back(tmp_path):
    async def run():
        room = room_in(tmp_path, max_spool_bytes=16 * len(CHUNK))
        first = await filled(room, "a", 12)
        with pytest.raises(ServiceBusy):
            await filled(room, "a", 1)
        second = await filled(room, "b", 4)
        with pytest.raises(ServiceBusy):
            await filled(room, "c", 1)
        first.clear()
        third = await filled(room, "c", 12)
        for spool in (second, third):
            spool.clear()

    asyncio.run(run())


def test_a_body_that_never_has_room_is_too_large_and_not_to_be_sent_again_later(tmp_path):
    async def run():
        room = room_in(tmp_path, max_spool_bytes=16 * len(CHUNK))
        spool = await filled(room, "a", 12)
        with pytest.raises(BodyTooLarge, match=f"at most {12 * len(CHUNK)} are kept"):
            await spool.write(CHUNK)
        assert len(spool) == 12 * len(CHUNK)
        spool.clear()
        parts = Spool(room, "a")  # one that is stored as it comes may be of any length
        for _ in range(13):
            await parts.write(CHUNK)
            parts.clear()

    asyncio.run(run())


def test_a_key_has_a_limited_number_of_bodies(tmp_path):
    room = room_in(tmp_path, bodies_per_key=2)
    with (
        room.spool("a"),
        room.spool("a"),
        room.spool("b"),
        pytest.raises(TooManyRequests),
        room.spool("a"),
    ):
        pass
    with room.spool("a"), room.spool("a"):
        pass


@pytest.mark.parametrize("chunks", [100, 200])
def test_a_body_that_ends_by_an_error_gives_back_its_room_and_memory(tmp_path, chunks):
    async def run():
        room = room_in(tmp_path, max_spool_bytes=300 * len(CHUNK), bodies_per_key=1)
        for _ in range(12):  # together they take more than there is, of either
            with pytest.raises(ClientDisconnect), room.spool("a") as spool:  # noqa: PT012  # the client leaves
                for _ in range(chunks):
                    await spool.write(CHUNK)
                assert (spool._file is None) == (chunks <= 100)
                raise ClientDisconnect

    asyncio.run(run())


class Closing:
    """A file that is closed when it may be, or cannot be closed."""

    def __init__(self, file, error=None):
        self._file, self._error = file, error
        self.may, self.by = threading.Event(), None

    def close(self):
        if self._file.closed:
            return
        self.by = threading.current_thread()
        assert self.by is threading.main_thread() or self.may.wait(10)
        self._file.close()
        if self._error is not None:
            raise self._error

    def __getattr__(self, name):
        return getattr(self._file, name)


async def with_file(room, key, error=None):
    """Return a spool of 2 MiB in a file."""
    spool = await filled(room, key, 32)
    spool._file = Closing(spool._file, error)
    return spool


def test_a_large_file_is_closed_in_a_thread_and_its_room_is_free_after_that(tmp_path, monkeypatch):
    """The kernel frees 3 GB in 1.5 s, in which nobody else would get an answer."""
    monkeypatch.setattr("app.http.bodies.spool._SLOW_BYTES", 2**20)

    async def run():
        room = room_in(tmp_path, max_spool_bytes=48 * len(CHUNK))
        assert room.lend(_SHARED_BYTES)  # to other bodies: these are in their files
        spool = await with_file(room, "a")
        file = spool._file
        spool.clear()
        assert len(spool) == 0
        with pytest.raises(ServiceBusy):
            room.take("b", 30 * len(CHUNK))
        await room.closed(0.0)  # no longer than it may
        file.may.set()
        await room.closed()
        assert file.closed
        assert file.by is not threading.main_thread()
        room.take("b", 30 * len(CHUNK))

    asyncio.run(run())


def test_a_large_file_is_closed_though_the_event_loop_ends(tmp_path, monkeypatch):
    monkeypatch.setattr("app.http.bodies.spool._SLOW_BYTES", 2**20)

    async def run():
        room = room_in(tmp_path)
        assert room.lend(_SHARED_BYTES)
        spool = await filled(room, "a", 32)
        file = spool._file
        spool.clear()
        return file

    assert asyncio.run(run()).closed


def test_a_small_file_is_closed_at_once(tmp_path):
    async def run():
        room = room_in(tmp_path)
        assert room.lend(_SHARED_BYTES)
        spool = await with_file(room, "a")
        file = spool._file
        spool.clear()
        assert file.by is threading.main_thread()

    asyncio.run(run())


def test_a_large_file_that_cannot_be_closed_is_logged_and_gives_back_its_room(
    tmp_path, monkeypatch, caplog
):
    monkeypatch.setattr("app.http.bodies.spool._SLOW_BYTES", 2**20)

    async def run():
        room = room_in(tmp_path, max_spool_bytes=48 * len(CHUNK))
        assert room.lend(_SHARED_BYTES)
        spool = await with_file(room, "a", OSError(errno.EIO, "input/output error"))
        spool._file.may.set()
        spool.clear()
        await room.closed()
        room.take("b", 30 * len(CHUNK))

    asyncio.run(run())
    assert "the file of a body cannot be closed" in caplog.text


class Sender:
    """Sends parts of a body after so many seconds each."""

    def __init__(self, *parts):
        self.parts = list(parts)

    async def receive(self):
        seconds, amount = self.parts.pop(0)
        await asyncio.sleep(seconds)
        return {"type": "http.request", "body": bytes(amount), "more_body": True}


def paced(**settings):
    expected = {"body_idle_s": 60.0, "body_grace_s": 60.0, "body_bytes_per_s": 1.0, **settings}
    return Pace(Settings(**expected))


async def taken(pace, sender):
    while sender.parts:
        await pace.next(sender.receive)


def test_a_body_that_is_idle_is_rejected():
    with pytest.raises(SlowBody, match=r"nothing of the body arrived for 0\.05 s"):
        asyncio.run(taken(paced(body_idle_s=0.05), Sender((0, 10), (60, 10))))


def test_a_body_that_becomes_too_slow_is_rejected_however_fast_it_began():
    pace = paced(body_bytes_per_s=10_000.0, body_grace_s=0.05)
    trickle = [(0.01, 1)] * 1_000
    with pytest.raises(SlowBody, match="slower than 10000 bytes a second"):
        asyncio.run(taken(pace, Sender((0, 10**9), *trickle)))


def test_without_a_minimum_rate_a_slow_body_is_read_to_its_end():
    sender = Sender(*[(0.001, 1)] * 20)
    asyncio.run(taken(paced(body_bytes_per_s=0.0), sender))
    assert sender.parts == []


def test_a_body_at_its_pace_is_read_and_time_that_we_take_does_not_count():
    async def run():
        # With our time it would be half as fast as it must be, and too late at the seventh part.
        pace = paced(body_bytes_per_s=1_000.0, body_grace_s=0.3)
        sender = Sender(*[(0.001, 50)] * 12)
        while sender.parts:
            await pace.next(sender.receive)
            await asyncio.sleep(0.1)  # as long as it takes us to store it

    asyncio.run(run())


HOSTILE = {
    "keys": b"{" + b",".join(b'"%d":1' % n for n in range(MOST_KEYS + 1)) + b"}",
    "values": b'{"map":[' + b"1," * MOST_VALUES + b"1]}",
    "empty lists": b"[" + b"[]," * MOST_VALUES + b"[]]",
    "depth": b'{"map":' + b"[" * 2_000 + b"]" * 2_000 + b"}",
    "depth of objects": b'{"a":' * 2_000 + b"1" + b"}" * 2_000,
    "depth behind texts": b'{"map":"'
    + b"]" * 3_000
    + b'","b":'
    + b"[" * 2_000
    + b"]" * 2_000
    + b"}",
    "depth behind escapes": b'{"map":"\\"' + b"]" * 3_000 + b'","b":' + b"[" * 2_000 + b"}",
}


@pytest.mark.parametrize("body", HOSTILE.values(), ids=HOSTILE)
def test_json_that_would_cost_much_is_rejected_before_it_is_parsed(body, monkeypatch):
    monkeypatch.setattr(json, "loads", lambda _: pytest.fail("it was parsed"))
    with pytest.raises(InvalidRequest, match=r"at most|deep"):
        read_json(body, MapIn)


def test_brackets_and_separators_in_texts_are_no_depth():
    body = json.dumps({"map": "campus", "description": '[{"\\' * 400}).encode()
    assert read_json(body, MapIn).description == '[{"\\' * 400
    assert MOST_DEPTH > 9


def test_the_largest_poses_that_the_api_describes_are_within_the_bounds():
    poses = [
        {"scan": n, "pose": [1.5, -2.0, 1.73, 0.0, 0.0, 0.0, 1.0], "timestamp_s": n + 0.5}
        for n in range(10_000)
    ]
    assert len(read_json(json.dumps({"poses": poses}).encode(), PosesIn).poses) == 10_000


@pytest.mark.parametrize("body", [b"", b"{", b"\xff", b"[" * 900, b"1" * 1_000, b'"\\ud800'])
def test_a_body_that_is_not_json_is_rejected(body):
    with pytest.raises(RequestValidationError):
        read_json(body, MapIn)


def test_a_large_body_gives_way_to_answers_between_its_pieces(tmp_path):
    async def pieces_before_each_way(folder, sizes):
        sent = iter(
            [{"type": "http.request", "body": bytes(n), "more_body": True} for n in sizes]
            + [{"type": "http.request", "body": b"", "more_body": False}]
        )
        gave_way: list[int] = []

        async def receive():
            return next(sent)

        async def give_way():
            gave_way.append(len(spool))

        incoming = Incoming(
            receive,
            sent_limit=2**20,
            unpacked_limit=2**20,
            decoder=None,
            digest=ContentDigest(""),
            pace=Pace(Settings()),
            spend=lambda _now, _all: None,
            room=room_in(folder),
            key="a",
            give_way=give_way,
        )
        with incoming.spool() as spool:
            await incoming.fill(spool)
        return gave_way

    assert asyncio.run(pieces_before_each_way(tmp_path, [100, 2000])) == []
    assert asyncio.run(pieces_before_each_way(tmp_path, [2**16, 100, 100])) == [
        2**16 + 100,
        2**16 + 200,
    ]
