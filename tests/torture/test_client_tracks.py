"""A vehicle with the client is tracked: over a restart, and into a new revision."""

import signal
import time

import numpy as np
import pytest
from tensormap_client import Unreachable, Vehicle

from tests.support.process import serving
from tests.support.recording import recording
from tests.support.service import upload, wait_for

pytestmark = pytest.mark.torture

CAMPUS = "/v1/maps/campus"
SCANS = 48
SAVED_EVERY_S = 1.0  # by the service: a killed one loses what is newer
QUERIES = recording(noise_seed=7).scans


@pytest.fixture
def data(tmp_path):
    return tmp_path / "data"


def fill(client):
    client.post("/v1/maps", json={"map": "campus"})
    upload(client, "monday", recording())
    build(client, {"segments": 2})


def build(client, parameters):
    job = client.post(f"{CAMPUS}/builds", json=parameters).json()["job"]
    ended = wait_for(client, job)
    assert ended["state"] == "done", ended
    return ended["revision"]


def drive(track, scans):
    """Pass some scans of the map's drive; return their answers, with the scan of each."""
    places_m = {scan: np.array(recording().pose(scan).as_tuple()[:2]) for scan in range(SCANS)}
    travelled_m = [float(np.linalg.norm(places_m[scan] - places_m[scan - 1])) for scan in scans]
    answers = [
        (scan, track.observe(QUERIES[scan].points_m, timestamp_s=0.1 * scan, travelled_m=metres))
        for scan, metres in zip(scans, travelled_m, strict=True)
    ]
    return [(scan, answer) for scan, answer in answers if answer is not None]


def require_right(answers):
    wrong = [(scan, a) for scan, a in answers if a.localized and abs(a.scan_index - scan) > 2]
    assert not wrong, wrong[0]
    assert all(round(a.timestamp_s / 0.1) == scan for scan, a in answers)
    numbers = [answer.sequence for _, answer in answers]
    assert numbers == sorted(set(numbers))


def test_a_track_goes_on_after_a_restart_and_in_a_new_revision(data, tmp_path):
    log = tmp_path / "log"
    with serving(data, log) as server:
        fill(server.client)
        port = server.port
        vehicle = Vehicle(f"http://127.0.0.1:{port}", None, "campus", timeout_s=20.0)
        track = vehicle.track()
        before = drive(track, range(1, 14))
        assert len(before) == 13
        assert before[-1][1].localized
        require_right(before)
        time.sleep(2 * SAVED_EVERY_S)
        server.end(signal.SIGKILL)

    assert track.observe(QUERIES[14].points_m, timestamp_s=1.4, travelled_m=1.0) is None
    assert isinstance(track.failure, Unreachable)

    with serving(data, log, port=str(port)) as server:
        track._not_before_s = 0.0  # the pause after a failed attempt
        after = drive(track, range(15, 25))
        require_right(after)
        assert after[-1][1].localized
        # It is the same track.
        assert after[-1][1].observations > 10
        assert track.failure is None

        old = after[-1][1].revision
        new = build(server.client, {"segments": 3, "make_live": True})
        handed = drive(track, range(25, 40))
        require_right(handed)
        assert all(answer.localized for _, answer in handed), "the place was lost"
        revisions = [answer.revision for _, answer in handed]
        taken = revisions.index(new)
        assert 1 <= taken <= 5
        assert revisions == [old] * taken + [new] * (len(handed) - taken)
        listed = server.client.get(f"{CAMPUS}/tracks").json()["items"]
        assert [one["revision"] for one in listed] == [new]

        # A track that the service forgot is begun again.
        server.client.delete(f"{CAMPUS}/tracks/{listed[0]['track']}")
        begun = drive(track, range(40, 48))
        require_right(begun)
        assert begun[0][1].observations == 1
        assert begun[-1][1].localized

        track.close()
        vehicle.close()
        assert server.client.get(f"{CAMPUS}/tracks").json()["items"] == []
    text = log.read_text()
    assert "Traceback" not in text, text
