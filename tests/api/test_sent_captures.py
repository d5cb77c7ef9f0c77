"""Captures that the client sends in parts, interrupted or not."""

import asyncio

import numpy as np
import pytest
from httpx2 import ASGITransport
from tensormap_client import AsyncMapper, CaptureFailed, Mapper

from tests.support.bags import cloud, record_bag

HERE = "http://127.0.0.1"
SCANS = [np.random.default_rng(seed).normal(0, 9, (100_000, 3)).astype("<f4") for seed in range(3)]


class Killed(BaseException):
    """The end of a client, between a request and its answer."""


class Line:
    """Connections to a service that count what is sent, and end when enough was."""

    def __init__(self, client) -> None:
        self._client = client
        self.sent_bytes, self.parts, self.most_bytes = 0, 0, 2**60

    def handle_request(self, request):
        content = request.read()
        answer = self._client._transport.handle_request(request)
        self.sent_bytes += len(content)
        self.parts += "/parts/" in request.url.path
        if self.sent_bytes > self.most_bytes:
            raise Killed
        return answer

    def close(self):
        pass


def mapper(line):
    return Mapper(HERE, None, "campus", connections=line)


def test_killed_three_times_it_sends_at_most_a_twentieth_more(empty, tmp_path):
    bag = record_bag(tmp_path / "monday", map(cloud, SCANS))
    size_bytes = sum(file.stat().st_size for file in bag.iterdir())
    line = Line(empty)
    for quarter in (1, 2, 3):
        line.most_bytes = quarter * size_bytes // 4
        with pytest.raises(Killed), mapper(line) as killed:
            killed.upload(bag, "monday")
    line.most_bytes = 2**60
    with mapper(line) as last:
        done = last.upload(bag, "monday")
    assert (done.scans, done.stored, done.before, done.skipped_scans) == (3, 3, 0, 0)
    assert size_bytes < line.sent_bytes <= 1.05 * size_bytes
    # What was read is not sent again.
    before = line.parts
    with mapper(line) as again:
        done = again.upload(bag, "monday")
    assert (done.scans, done.stored, done.before, done.sent_bytes) == (3, 0, 3, 0)
    assert line.parts == before


def test_an_unknown_topic_fails_with_those_there_are_and_another_sends_no_part(empty, tmp_path):
    few = [points[:1000] for points in SCANS]
    bag = record_bag(tmp_path / "two", map(cloud, few), topics=("/front", "/rear"))
    line = Line(empty)
    with mapper(line) as sending:
        with pytest.raises(CaptureFailed, match=r"^capture job .* failed: .*/front \(3\), /rear"):
            sending.upload(bag, "monday")
        parts = line.parts
        assert sending.upload(f"{bag}#/rear", "monday").stored == 3
    assert line.parts == parts


def test_the_asynchronous_client_does_the_same(empty, tmp_path):
    bag = record_bag(tmp_path / "monday", [cloud(SCANS[0][:1000]), cloud(SCANS[1][:20])])

    async def upload():
        connections = ASGITransport(app=empty.app)
        async with AsyncMapper(HERE, None, "campus", connections=connections) as sending:
            return await sending.upload(bag, "monday")

    done = asyncio.run(upload())
    assert (done.stored, done.skipped_scans) == (1, 1)
    assert done.notes[0].startswith("scan 1 was skipped: ")
