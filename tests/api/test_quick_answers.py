"""Fixes by signature and observations over HTTP: quick ones are made without a thread."""

import gzip
import json
import re
import threading
from itertools import count

import pytest

from app.http.pools import Pool
from core.encodings.signature import pack_signatures
from tests.support.campus import IMAGE, MAP, PACKED
from tests.support.service import copy_of, problem_of, running
from tests.support.tracks import as_json, new_track, signed

FIX = f"{MAP}/localizations/signature"
_UNUSED = count(2)  # numbers of matches


@pytest.fixture(scope="module", params=["paper", "harmonic"])
def client(tmp_path_factory, campus_of, request):
    built = campus_of(segments=3, encoding=request.param)
    data_dir = copy_of(built, tmp_path_factory.mktemp("quick") / "data")
    with running(data_dir) as client:
        yield client


@pytest.fixture
def in_thread(client, monkeypatch):
    """The threads of the requests so far: whether each took one of the pool of short answers."""
    run, taken = Pool.run, []

    async def noted(pool, key, work, **options):
        taken.append(pool)
        return await run(pool, key, work, **options)

    monkeypatch.setattr(Pool, "run", noted)
    monkeypatch.setattr("app.quick_work._QUICK_S", 60.0)

    def ask(*request, **options):
        del taken[:]
        answer = client.post(*request, **options)
        return answer, bool(taken)

    return ask


@pytest.fixture(params=["fix", "observation"])
def path(client, request):
    """A path that takes signatures, and has not had any."""
    if request.param == "fix":
        return f"{FIX}?k={next(_UNUSED)}"
    return f"{new_track(client)}/observations"


def test_after_the_first_an_answer_needs_no_thread_and_is_the_same(client, basis, path, in_thread):
    body = pack_signatures(signed(basis, 5))
    first, took_thread = in_thread(path, content=body, headers=PACKED)
    assert took_thread
    second, took_thread = in_thread(path, content=body, headers=PACKED)
    assert not took_thread
    assert first.status_code == second.status_code == 200
    if path.startswith(FIX):
        assert second.content == first.content
    else:
        assert second.json()["observations"] == 2


def test_what_changed_in_the_catalog_is_read_in_a_thread(client, basis, path, in_thread):
    body = pack_signatures(signed(basis, 5))
    for _ in range(2):
        in_thread(path, content=body, headers=PACKED)
    client.patch(MAP, json={"description": "changed"}).raise_for_status()
    assert [in_thread(path, content=body, headers=PACKED)[1] for _ in range(2)] == [True, False]


def test_long_and_compressed_bodies_are_opened_in_a_thread(client, basis, path, in_thread):
    shown = json.dumps(as_json(signed(basis, 5)), separators=(",", ":"))
    short = re.sub(r"\.[0-9e-]+", "", shown).encode()
    of_one_kibibyte, longer = (short.ljust(size) for size in (2**10, 2**10 + 1))
    assert len(of_one_kibibyte) == 2**10
    heads = {"Content-Type": "application/json"}
    for _ in range(2):
        answer, took_thread = in_thread(path, content=of_one_kibibyte, headers=heads)
        assert answer.status_code == 200, answer.text
    assert not took_thread
    for _ in range(2):
        assert in_thread(path, content=longer, headers=heads)[1]
    packed = gzip.compress(of_one_kibibyte)
    for _ in range(2):
        answer, took_thread = in_thread(
            path, content=packed, headers={**heads, "Content-Encoding": "gzip"}
        )
        assert answer.status_code == 200
        assert took_thread


def test_options_that_a_fix_has_not_had_are_measured_in_a_thread(client, basis, in_thread):
    body = pack_signatures(signed(basis, 5))
    k = next(_UNUSED)
    for query in (f"?k={k}", f"?k={k}&min_probability=0.5", f"?k={next(_UNUSED)}"):
        taken = [in_thread(FIX + query, content=body, headers=PACKED)[1] for _ in range(2)]
        assert taken == [True, False]


def test_a_query_for_many_matches_is_heavy_work(client, basis, in_thread, monkeypatch):
    run, pools, used = Pool.run, client.service.pools, []

    async def noted(pool, key, work, **options):
        used.append("heavy" if pool is pools.heavy else "short")
        return await run(pool, key, work, **options)

    monkeypatch.setattr(Pool, "run", noted)
    body = pack_signatures(signed(basis, 5))
    for k, pool in ((32, "short"), (33, "heavy"), (1000, "heavy")):
        answer = client.post(f"{FIX}?k={k}", content=body, headers=PACKED)
        assert len(answer.json()["matches"]) == min(k, 48)
        assert used.pop() == pool
        client.post(f"{MAP}/localizations/image?k={k}", content=b"none", headers=IMAGE)
        assert used.pop() == pool


def test_a_rejected_query_is_rejected_in_the_same_words_without_a_thread(
    client, basis, path, in_thread
):
    stale = bytearray(pack_signatures(signed(basis, 5)))
    stale[1:9] = bytes(8)
    first, second = (in_thread(path, content=bytes(stale), headers=PACKED)[0] for _ in range(2))
    assert problem_of(first) == problem_of(second) == (409, "stale-signature")
    assert first.json()["detail"] == second.json()["detail"]


def test_a_request_waits_in_a_thread_for_a_track_that_another_one_holds(client, basis, in_thread):
    track = new_track(client)
    body = pack_signatures(signed(basis, 5))
    for _ in range(2):
        in_thread(f"{track}/observations", content=body, headers=PACKED)
    held = client.service.tracks._tracks[track.rpartition("/")[2]]._lock
    held.acquire()
    release = threading.Timer(0.2, held.release)
    release.start()
    answer, took_thread = in_thread(f"{track}/observations", content=body, headers=PACKED)
    release.join()
    assert took_thread
    assert answer.json()["observations"] == 3


def test_beside_heavy_work_an_answer_is_made_in_a_thread(client, basis, path, in_thread):
    body = pack_signatures(signed(basis, 5))
    for _ in range(2):
        in_thread(path, content=body, headers=PACKED)
    begun, end = threading.Event(), threading.Event()

    def work():
        begun.set()
        assert end.wait(10)

    heavy = client.portal.start_task_soon(client.service.pools.heavy.run, "another key", work)
    assert begun.wait(10)
    taken = in_thread(path, content=body, headers=PACKED)[1]
    end.set()
    heavy.result()
    assert [taken, in_thread(path, content=body, headers=PACKED)[1]] == [True, False]
