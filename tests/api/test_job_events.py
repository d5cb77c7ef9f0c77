"""Jobs' server-sent events, continued from the last one that a client received."""

import json
from datetime import UTC, datetime, timedelta

import pytest

from storage.catalog import JobState
from tests.support.service import problem_of, wait_for
from tests.support.workers import never_end


def events_in(text):
    """Return `(id, job)` of each event of a stream."""
    blocks = [block for block in text.split("\n\n") if block and not block.startswith(":")]
    fields = [dict(line.split(": ", 1) for line in block.split("\n")) for block in blocks]
    return [(field["id"], json.loads(field["data"])) for field in fields]


def follow(client, job, **headers):
    answer = client.get(f"/v1/jobs/{job}/events", headers=headers)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/event-stream")
    assert answer.headers["cache-control"] == "no-store"
    return events_in(answer.text)


def test_a_build_is_followed_to_its_end(own):
    job = own.post("/v1/maps/campus/builds", json={"segments": 2, "encoding": "paper"}).json()[
        "job"
    ]
    events = follow(own, job)
    ids = [one for one, _ in events]
    assert len(set(ids)) == len(ids)
    states = [job["state"] for _, job in events]
    assert states[-1] == "done"
    assert set(states) <= {"queued", "running", "done"}
    assert events[-1][1] == own.get(f"/v1/jobs/{job}").json()


def test_a_client_that_reconnects_gets_no_event_twice(built, client):
    [(last, job)] = follow(client, built.job)
    assert job["state"] == "done"
    again = client.get(f"/v1/jobs/{built.job}/events", headers={"Last-Event-ID": last})
    assert (again.status_code, again.content) == (204, b"")
    assert follow(client, built.job, **{"Last-Event-ID": "running:fitting:3:48"}) == [(last, job)]


@pytest.mark.parametrize(
    ("query", "last"), [("", ["cancelled"]), ("?purge=true", [])], ids=["deleted", "purged"]
)
def test_a_job_that_goes_with_its_map_ends_its_events(own, monkeypatch, query, last):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    job = own.post("/v1/maps/campus/builds", json={"segments": 2}).json()["job"]
    wait_for(own, job, {"running"})
    shown = []
    with own.stream("GET", f"/v1/jobs/{job}/events") as answer:
        for line in answer.iter_lines():
            if line.startswith("data: "):
                shown.append(json.loads(line.removeprefix("data: "))["state"])
                if own.get("/v1/maps/campus").status_code == 200:
                    own.delete(f"/v1/maps/campus{query}")
    assert shown == ["running", *last]


def test_there_are_no_events_of_no_job(client):
    assert problem_of(client.get("/v1/jobs/none/events")) == (404, "job-not-found")


def test_the_remaining_time_of_a_stage_follows_its_pace(own, monkeypatch):
    monkeypatch.setattr("app.jobs.runner.run_job", never_end)
    jobs = own.service.store.jobs
    job = own.post("/v1/maps/campus/builds", json={"segments": 2}).json()["job"]
    wait_for(own, job, {"running"})
    assert own.get(f"/v1/jobs/{job}").json()["remaining_s"] is None
    assert jobs.progress(job, "fitting", 0, 48).remaining_s(datetime.now(UTC)) is None
    begun = jobs.progress(job, "fitting", 12, 48)
    assert begun.stage_started_at is not None
    later = begun.stage_started_at + timedelta(seconds=5)
    assert begun.remaining_s(later) == pytest.approx(15.0)
    asked = datetime.now(UTC)
    answer = timedelta(seconds=own.get(f"/v1/jobs/{job}").json()["remaining_s"])
    assert asked <= begun.stage_started_at + answer / 3 <= datetime.now(UTC)
    again = jobs.progress(job, "fitting", 24, 48)
    assert again.stage_started_at == begun.stage_started_at
    assert jobs.progress(job, "calibrating", 1, 2).stage_started_at > begun.stage_started_at
    assert own.delete(f"/v1/jobs/{job}").status_code == 200
    ended = wait_for(own, job)
    assert (ended["state"], ended["remaining_s"]) == (JobState.CANCELLED, None)
