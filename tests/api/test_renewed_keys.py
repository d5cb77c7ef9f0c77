"""A client takes another key, as when a token ends: what it does goes on under that one."""

import contextlib
from datetime import datetime, timedelta

import httpx2
import pytest
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect
from tensormap_client import Admin, InvalidArgument, Locator, Unreachable, Vehicle
from tensormap_client.io_sync import Stream
from tensormap_client.problems import KeyNeeded, KeyRefused
from tensormap_client.rejections import rejection

from tests.support.access import ADMIN, ADMIN_KEY, make
from tests.support.campus import MAP
from tests.support.client_calls import HERE, watched
from tests.support.recording import recording
from tests.support.service import copy_of, running
from tests.support.tracks import TRACKS, open_stream

SCANS = [scan.points_m for scan in recording(noise_seed=7).scans]


@pytest.fixture
def client(campus_of, tmp_path):
    data_dir = copy_of(campus_of(segments=3, encoding="harmonic"), tmp_path / "data")
    with running(data_dir, admin_key=ADMIN_KEY) as client:
        yield client


class StreamHere:
    """A stream of the client, to the service in this process."""

    def __init__(self, client, path, headers):
        self._opened = contextlib.ExitStack()
        try:
            self._session = self._opened.enter_context(open_stream(client, path, headers=headers))
        except WebSocketDenialResponse as refused:
            raise rejection(path, refused.status_code, refused.content, refused.headers) from None
        self.headers = httpx2.Headers(self._session.extra_headers)

    def exchange(self, message, _timeout_s):
        try:
            self._session.send_bytes(message)
            return self._session.receive_text()
        except WebSocketDisconnect as error:
            raise Unreachable("the stream broke off") from error

    def close(self):
        self._opened.close()


@pytest.fixture
def sent_with(client, monkeypatch):
    """The keys that requests and streams of clients are sent with from now on."""
    keys = []

    def opened(url, headers, *_tls_and_time, **_proxy):
        keys.append(headers["Authorization"])
        return StreamHere(client, url.removeprefix("ws://127.0.0.1"), headers)

    monkeypatch.setattr(Stream, "open", opened)
    return keys


@pytest.fixture
def connections(client, sent_with):
    return watched(client, lambda request, _: sent_with.append(request.headers["Authorization"]))


@pytest.fixture
def exchange(client):
    """Exchanges a key of a fleet for tokens."""
    key = make(client, "localize", maps=["campus"])["secret"]
    with Admin(HERE, key, connections=client._transport) as admin:
        yield lambda expires_in_s: admin.exchange_token(expires_in_s=expires_in_s)["secret"]


@pytest.fixture
def later(monkeypatch):
    """Moves the service's clock for keys."""

    def move(seconds):
        class Later(datetime):
            @classmethod
            def now(cls, tz=None):
                return datetime.now(tz) + timedelta(seconds=seconds)

        monkeypatch.setattr("app.access.access.datetime", Later)

    return move


def drive(track, scans):
    answers = [track.observe(SCANS[scan], timestamp_s=float(scan)) for scan in scans]
    return [answer.observations for answer in answers], answers[-1].localized


def tracks_of(client):
    return [one["track"] for one in client.get(TRACKS, headers=ADMIN).json()["items"]]


def test_a_track_goes_on_under_a_token_that_is_renewed_before_it_ends(
    client, connections, sent_with, exchange, later
):
    first, second = exchange(60), exchange(3600)
    with Vehicle(HERE, first, "campus", connections=connections) as vehicle:
        track = vehicle.track()
        assert drive(track, range(5)) == ([1, 2, 3, 4, 5], True)
        [before] = tracks_of(client)
        assert set(sent_with) == {f"Bearer {first}"}
        vehicle.set_key(second)
        del sent_with[:]
        later(120)
        assert drive(track, range(5, 8)) == ([6, 7, 8], True)
        assert vehicle.locate(SCANS[8]).localized
        assert tracks_of(client) == [before]
        track.close()
        assert tracks_of(client) == []
        assert set(sent_with) == {f"Bearer {second}"}


def test_a_track_goes_on_under_a_new_token_after_its_token_ended(
    client, connections, exchange, later
):
    first, second = exchange(60), exchange(3600)
    with Vehicle(HERE, first, "campus", connections=connections) as vehicle:
        track = vehicle.track()
        drive(track, range(5))
        before = tracks_of(client)
        later(120)
        for _ in range(2):  # in its stream, and when that is opened again
            with pytest.raises(KeyRefused, match="expired"):
                track.observe(SCANS[5], timestamp_s=5.0)
        vehicle.set_key(second)
        assert drive(track, range(6, 9)) == ([6, 7, 8], True)
        assert tracks_of(client) == before


def test_a_track_goes_on_under_another_key_and_the_old_one_can_be_revoked(client, connections):
    old, new = (make(client, "localize") for _ in range(2))
    with Vehicle(HERE, old["secret"], "campus", connections=connections) as vehicle:
        track = vehicle.track()
        drive(track, range(5))
        vehicle.set_key(new["secret"])
        client.delete(f"/v1/keys/{old['key']}", headers=ADMIN).raise_for_status()
        assert drive(track, range(5, 8)) == ([6, 7, 8], True)
        assert len(tracks_of(client)) == 1


def test_a_locator_and_an_administrator_take_another_key_and_may_have_none(client, connections):
    basis = {"name": "city", "maps": ["campus"]}
    client.post("/v1/bases", json=basis, headers=ADMIN).raise_for_status()
    old, new = (make(client, "localize", "maps:read") for _ in range(2))
    with (
        Locator(HERE, old["secret"], "city", connections=connections) as locator,
        Admin(HERE, old["secret"], connections=client._transport) as admin,
    ):
        assert locator.locate(SCANS[8]).map == "campus"
        client.delete(f"/v1/keys/{old['key']}", headers=ADMIN).raise_for_status()
        for one in (locator, admin):
            one.set_key(new["secret"])
            with pytest.raises(InvalidArgument, match="the key"):
                one.set_key("two\nlines")
        assert locator.locate(SCANS[8]).map == "campus"
        assert admin.map("campus")["map"] == MAP.rpartition("/")[2]
        admin.set_key(None)
        with pytest.raises(KeyNeeded):
            admin.map("campus")
