"""Answers from what is kept of the catalog: no query while nothing changed."""

import threading
import time
from contextlib import contextmanager

import pytest
from sqlalchemy import event

from core.encodings.signature import pack_signatures
from tests.support.access import ADMIN_KEY
from tests.support.campus import MAP, PACKED, basis_of
from tests.support.recording import recording
from tests.support.service import problem_of, running, upload, wait_for

PLAIN = {"segments": 2, "encoding": "harmonic", "views": "full"}


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def client(tmp_path_factory, request):
    """A service with a key and a map."""
    url = None
    if request.param == "postgresql":
        url = request.getfixturevalue("postgresql").new_database()
    data_dir = tmp_path_factory.mktemp("kept") / "data"
    with running(data_dir, catalog_url=url, admin_key=ADMIN_KEY) as client:
        client.headers["Authorization"] = f"Bearer {ADMIN_KEY}"
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording())
        queued = client.post(f"{MAP}/builds", json=PLAIN)
        assert wait_for(client, queued.json()["job"])["state"] == "done"
        yield client


@pytest.fixture(scope="module")
def vehicle(client):
    """The head of a vehicle's requests."""
    wanted = {"name": "vehicle", "scopes": ["localize", "maps:read"]}
    secret = client.post("/v1/keys", json=wanted).json()["secret"]
    return {**PACKED, "Authorization": f"Bearer {secret}"}


@pytest.fixture(scope="module")
def asked(client, vehicle):
    """Requests of a vehicle: a fix, an observation, its track and its map."""
    basis = basis_of(client)
    query = pack_signatures(basis.encode(basis.image(recording(scans=4).scans[1])))
    track = client.post(f"{MAP}/tracks", headers=vehicle).json()["track"]

    def ask():
        answers = [
            client.post(f"{MAP}/localizations/signature", content=query, headers=vehicle),
            client.post(f"{MAP}/tracks/{track}/observations", content=query, headers=vehicle),
            client.get(f"{MAP}/tracks/{track}", headers=vehicle),
            client.get(MAP, headers=vehicle),
        ]
        assert [answer.status_code for answer in answers] == [200] * 4, answers[0].text
        return answers

    return ask


@contextmanager
def queries(client):
    """Collect the statements that the service sends to its catalog, except its look for jobs."""
    engine, sent = client.service.store.catalog._database.engine, []

    def collect(_connection, _cursor, statement, *_):
        if not threading.current_thread().name.startswith("jobs-"):
            sent.append(statement)

    event.listen(engine, "before_cursor_execute", collect)
    yield sent
    event.remove(engine, "before_cursor_execute", collect)


def settled(client, asked):
    """Ask until all is kept: the build's last commits, and PostgreSQL's channel, take a while."""
    for _ in range(100):
        with queries(client) as sent:
            asked()
        if not sent:
            return
        time.sleep(0.1)
    raise AssertionError(sent)


def test_answers_make_no_query_while_nothing_changed(client, asked):
    settled(client, asked)
    with queries(client) as sent:
        for _ in range(5):
            asked()
    assert sent == []


def test_signatures_that_abbreviate_their_basis_do_not_fill_the_memory(client, asked):
    basis = basis_of(client)
    [signature] = basis.encode(basis.image(recording(scans=4).scans[1]))
    of = {"values_real": signature.values.real, "values_imag": signature.values.imag}
    sent = [{name: part.tolist() for name, part in of.items()}]
    settled(client, asked)
    kept = client.service.store.catalog._database.kept
    before = len(kept._of[1])
    for end in range(16, 64):
        body = {"revision": signature.revision[:end], "signatures": sent}
        assert client.post(f"{MAP}/localizations/signature", json=body).is_success
    assert len(kept._of[1]) - before <= 2


def test_answers_make_no_query_after_a_key_was_exchanged_for_a_token(client, vehicle, asked):
    settled(client, asked)
    exchanged = client.post(
        "/v1/tokens", json={}, headers={"Authorization": vehicle["Authorization"]}
    )
    assert exchanged.status_code == 201
    with queries(client) as sent:
        asked()
    assert sent == []


def test_a_change_of_the_map_is_in_the_next_answer(client, asked):
    for number in range(5):
        settled(client, asked)
        client.patch(MAP, json={"description": f"change {number}"})
        assert asked()[3].json()["description"] == f"change {number}"


def test_a_map_that_is_deleted_is_gone_from_the_next_answer_on(client, vehicle):
    client.post("/v1/maps", json={"map": "short"})
    for _ in range(3):
        assert client.get("/v1/maps/short", headers=vehicle).status_code == 200
    client.delete("/v1/maps/short")
    gone = client.get("/v1/maps/short", headers=vehicle)
    assert problem_of(gone) == (404, "map-not-found")
