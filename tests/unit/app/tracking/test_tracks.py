"""The tracks of a service: shared trackers, limits, idle tracks, and those that are saved."""

import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import pytest

import app.tracking.tracks
from app.http.errors import TooManyTracks, TooManyTracksOfKey, TrackNotFound
from app.quick_work import NotQuick, quickly
from app.tracking.live_track import TrackUnloaded
from app.tracking.tracks import Tracks
from core.localization.localizer import Localizer
from core.tracking.track import Track, Tracker
from storage.catalog import SavedTracks
from storage.catalog.kept import Kept
from storage.errors import StorageUnavailable
from tests.support.samples import observed, sample_harmonic_map, sample_map


@pytest.fixture(scope="module", params=[sample_map, sample_harmonic_map])
def tracker(request):
    return Tracker(Localizer(request.param(count=40, segment_length=10)[0]))


@pytest.fixture
def saved(tmp_path):
    opened = SavedTracks(f"sqlite:///{tmp_path}/tracks", Kept())
    yield opened
    opened.close()


def _at(now):
    return {"clock": lambda: now[0], "monotonic": lambda: now[0]}


def test_tracks_of_one_revision_share_its_tracker_and_are_removed_when_idle(tracker, saved):
    now = [0.0]
    tracks = Tracks(limit=2, idle_s=60.0, per_key=2, revisions=9, saved=saved, **_at(now))
    one, two = (tracks.create("m", key, tracker.localizer) for key in "ab")
    assert one._tracker is two._tracker
    with pytest.raises(TooManyTracks):
        tracks.create("m", "a", tracker.localizer)
    now[0] = 50.0
    assert tracks.get("m", one.id) is one
    with pytest.raises(TrackNotFound):
        tracks.get("another map", one.id)
    now[0] = 100.0
    with pytest.raises(TrackNotFound, match="removed 60 s"):
        tracks.get("m", two.id)
    assert len(tracks) == 1
    tracks.delete("m", one.id)
    assert len(tracks) == 0


@pytest.mark.parametrize("set_by_s", [601.0, -3600.0])
def test_a_clock_that_is_set_neither_ends_a_track_nor_keeps_an_idle_one(tracker, saved, set_by_s):
    now_s, ticks_s = [1e9], [50.0]
    tracks = Tracks(9, 60.0, 9, 9, saved, clock=lambda: now_s[0], monotonic=lambda: ticks_s[0])
    created = tracks.create("m", "key", tracker.localizer)
    now_s[0] += set_by_s
    ticks_s[0] += 1.0
    tracks.create("m", "key", tracker.localizer)  # which removes the saved ones that are idle
    assert tracks.get("m", created.id) is created
    tracks.save()
    assert tracks.get("m", created.id) is created
    assert [found.used_s for found in saved.used_since(0.0)] == [now_s[0]] * 2
    ticks_s[0] += 61.0
    assert len(tracks) == 0


def test_a_track_that_another_process_saved_is_idle_since_then(tracker, saved):
    name = Tracks(9, 60.0, 9, 9, saved, clock=lambda: 1e9).create("m", "a", tracker.localizer).id
    ticks_s = [50.0]
    tracks = Tracks(9, 60.0, 9, 9, saved, clock=lambda: 1e9 + 40.0, monotonic=lambda: ticks_s[0])
    resumed = tracks.get("m", name, lambda _: tracker.localizer)
    assert resumed.used_s == 1e9 + 40.0
    ticks_s[0] += 59.0
    assert len(tracks) == 1


def test_a_track_that_is_only_looked_at_is_saved_as_it_was_and_its_gap_ends_when_it_observes(
    tracker, saved
):
    now = [100.0]
    tracks = Tracks(9, 600.0, 9, 9, saved, **_at(now))
    name = tracks.create("m", "a", tracker.localizer).id
    for row in range(5):
        tracks.get("m", name).observe(observed(tracker, row))
    tracks.save()
    state = saved.get(name).state
    for _ in range(3):
        now[0] += 2.0
        tracks = Tracks(9, 600.0, 9, 9, saved, **_at(now))
        resumed = tracks.get("m", name, lambda _: tracker.localizer)
        tracks.save()
        assert saved.get(name).used_s == now[0]
        assert saved.get(name).state == state
    now[0] += 30.0
    resumed.observe(observed(tracker, 20))
    assert resumed.gap_s == 36.0
    assert saved.get(name).state == state
    tracks.save()
    assert saved.get(name).state != state


def test_two_requests_for_a_saved_track_get_the_same_one(tracker, saved):
    at_once = threading.Barrier(2)

    def localizer_of(revision):
        at_once.wait()
        return tracker.localizer

    def resume(_):
        return tracks.get("m", name, localizer_of)

    name = Tracks(5, 60.0, 5, 5, saved).create("m", "a", tracker.localizer).id
    tracks = Tracks(5, 60.0, 5, 5, saved)
    with ThreadPoolExecutor(2) as pool:
        one, two = pool.map(resume, range(2))
    assert one is two


def test_a_key_at_its_limit_of_tracks_does_not_stop_others(tracker, saved):
    tracks = Tracks(limit=5, idle_s=60.0, per_key=3, revisions=9, saved=saved)
    for _ in range(3):
        tracks.create("m", "greedy", tracker.localizer)
    with pytest.raises(TooManyTracksOfKey, match="greedy has reached the limit of 3 tracks"):
        tracks.create("m", "greedy", tracker.localizer)
    tracks.create("m", "other", tracker.localizer)
    assert len(tracks) == 4


def test_a_track_that_cannot_be_saved_replaces_none(tracker, saved, monkeypatch):
    tracks = Tracks(limit=4, idle_s=60.0, per_key=4, revisions=9, saved=saved)
    greedy = [tracks.create("m", "greedy", tracker.localizer) for _ in range(4)]

    def refuse(*_):
        raise StorageUnavailable("the disk is gone for a moment")

    with monkeypatch.context() as patch:
        patch.setattr(saved, "add", refuse)
        with pytest.raises(StorageUnavailable):
            tracks.create("m", "modest", tracker.localizer)
    assert [tracks.get("m", one.id) for one in greedy] == greedy
    assert {one.id for one in saved.used_since(0.0)} == {one.id for one in greedy}
    tracks.create("m", "modest", tracker.localizer)
    assert len(tracks) == len(saved.used_since(0.0)) == 4


def test_two_tracks_that_are_made_at_once_replace_two(tracker, saved, monkeypatch):
    tracks = Tracks(limit=4, idle_s=60.0, per_key=4, revisions=9, saved=saved)
    for _ in range(4):
        tracks.create("m", "greedy", tracker.localizer)
    add, at_once = saved.add, threading.Barrier(2)

    def add_at_once(*given):
        at_once.wait()
        add(*given)

    monkeypatch.setattr(saved, "add", add_at_once)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda key: tracks.create("m", key, tracker.localizer), ("one", "two")))
    left = saved.used_since(0.0)
    assert sorted(track.key_id for track in left) == ["greedy", "greedy", "one", "two"]
    assert len(tracks) == 4


def test_a_key_below_its_share_replaces_the_longest_idle_track_of_the_key_with_most(tracker, saved):
    now = [0.0]
    tracks = Tracks(limit=6, idle_s=60.0, per_key=6, revisions=9, saved=saved, **_at(now))
    modest = [tracks.create("m", "modest", tracker.localizer) for _ in range(2)]
    greedy = [tracks.create("m", "greedy", tracker.localizer) for _ in range(4)]
    now[0] = 10.0
    tracks.get("m", greedy[0].id)
    third = tracks.create("m", "modest", tracker.localizer)
    with pytest.raises(TrackNotFound):
        tracks.get("m", greedy[1].id)
    kept = [*modest, third, greedy[0], *greedy[2:]]
    assert [tracks.get("m", one.id) for one in kept] == kept
    for key in ("modest", "greedy"):  # each has its share
        with pytest.raises(TooManyTracks):
            tracks.create("m", key, tracker.localizer)
    late = [tracks.create("m", "late", tracker.localizer) for _ in range(2)]
    with pytest.raises(TooManyTracks):
        tracks.create("m", "late", tracker.localizer)
    assert len(tracks) == 6
    assert [tracks.get("m", one.id) for one in late] == late


def test_for_another_revision_the_tracks_of_that_used_longest_ago_are_unloaded(tracker, saved):
    now = [0.0]
    tracks = Tracks(9, 60.0, 9, revisions=2, saved=saved, **_at(now))
    names, models = {}, {}
    for second, map_id in enumerate("abc"):
        now[0] = second
        created = tracks.create(map_id, "key", tracker.localizer)
        created.observe(observed(tracker, 4, sequence=second))
        names[map_id], models[map_id] = created.id, weakref.ref(created._tracker)
        del created
    assert [models[map_id]() is None for map_id in "abc"] == [True, False, False]
    assert len(tracks) == 3
    resumed = tracks.get("a", names["a"], lambda _: tracker.localizer)
    assert (resumed.observations, resumed.sequence) == (1, 0)
    assert [models[map_id]() is None for map_id in "abc"] == [True, True, False]


@pytest.mark.parametrize("without_tracks", [1, 2])
def test_one_revision_is_unloaded_for_another_whether_or_not_all_have_tracks_yet(
    tracker, saved, without_tracks
):
    now = [0.0]
    tracks = Tracks(9, 60.0, 9, revisions=6, saved=saved, **_at(now))
    created = []
    for second, map_id in enumerate("abcdef"):
        now[0] = second
        created.append(tracks.create(map_id, "key", tracker.localizer))
    in_use = [track._tracker for track in created[-without_tracks:]]
    for track in created[-without_tracks:]:
        tracks.delete(track.map_id, track.id)
    models = [weakref.ref(track._tracker) for track in created]
    del created, track
    tracks.create("g", "key", tracker.localizer)
    assert [model() is None for model in models] == [True, *[False] * 5]
    assert [model() for model in models[-without_tracks:]] == in_use


def test_revisions_that_are_prepared_at_once_do_not_exceed_the_limit(tracker, saved, monkeypatch):
    now = [0.0]
    tracks = Tracks(9, 60.0, 9, revisions=2, saved=saved, **_at(now))
    models = []
    for second, map_id in enumerate("ab"):
        now[0] = second
        models.append(weakref.ref(tracks.create(map_id, "key", tracker.localizer)._tracker))
    now[0] = 2.0
    at_once = threading.Barrier(2)

    def prepared(localizer):
        at_once.wait(60)
        return Tracker(localizer)

    monkeypatch.setattr(app.tracking.tracks, "Tracker", prepared)
    with ThreadPoolExecutor(2) as pool:
        made = pool.map(lambda map_id: tracks.create(map_id, "key", tracker.localizer), "cd")
        models += [weakref.ref(track._tracker) for track in made]
    assert [model() is None for model in models] == [True, True, False, False]


def test_a_track_that_is_unloaded_takes_no_observation_that_nobody_would_save(tracker, saved):
    tracks = Tracks(9, 60.0, 9, revisions=1, saved=saved)
    found = tracks.create("a", "key", tracker.localizer)
    tracks.create("b", "key", tracker.localizer)
    with pytest.raises(TrackUnloaded):
        found.observe(observed(tracker, 4))
    again = tracks.get("a", found.id, lambda _: tracker.localizer)
    assert again.observe(observed(tracker, 4)).observations == 1


def test_a_track_that_cannot_be_saved_is_not_unloaded(tracker, saved, monkeypatch):
    tracks = Tracks(9, 60.0, 9, revisions=1, saved=saved)
    found = tracks.create("a", "key", tracker.localizer)
    found.observe(observed(tracker, 4))
    monkeypatch.setattr(type(found), "to_save", lambda *_: 1 / 0)
    tracks.create("b", "key", tracker.localizer)
    assert tracks.get("a", found.id) is found
    assert found.observe(observed(tracker, 5)).observations == 2


def test_while_an_observation_is_taken_saving_waits_and_the_event_loop_does_not(
    tracker, saved, monkeypatch
):
    tracks = Tracks(9, 60.0, 9, 9, saved)
    track = tracks.create("m", "key", tracker.localizer)
    entered, leave = threading.Event(), threading.Event()
    observe = Track.observe

    def slow(self, observation):
        entered.set()
        assert leave.wait(10.0)
        return observe(self, observation)

    monkeypatch.setattr(Track, "observe", slow)
    with ThreadPoolExecutor(3) as pool:
        first = pool.submit(track.observe, observed(tracker, 2))
        try:
            assert entered.wait(10.0)
            quick = pool.submit(quickly, lambda: track.observe(observed(tracker, 3)), nullcontext())
            with pytest.raises(NotQuick):
                quick.result(2.0)
            track.use()
            saving = pool.submit(tracks.save)
            with pytest.raises(TimeoutError):
                saving.result(0.2)
        finally:
            leave.set()
        assert first.result(10.0).observations == 1
        saving.result(10.0)
    kept = saved.get(track.id)
    assert kept is not None
    assert kept.observations == 1
