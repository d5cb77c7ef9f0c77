"""Proposed loop closures over HTTP."""

import pytest

from app.localization.signature_schemas import SignaturesIn
from core.loop_closure.closure import check_scans
from tests.support.campus import basis_of
from tests.support.recording import kitti, recording
from tests.support.service import problem_of, upload, wait_for

CLOSURES = "/v1/maps/campus/loop-closures"


def stored(index, drive="monday"):
    return {"drive": drive, "scan_index": index}


def signatures_of(client, scan):
    basis = basis_of(client)
    sent = SignaturesIn.from_core(basis.encode(basis.image(scan)))
    return sent.model_dump(exclude_none=True)


def test_stored_scans_are_checked_in_a_batch_in_their_order(client):
    proposals = [{"first": stored(3), "second": stored(second)} for second in (3, 4, 25)]
    answer = client.post(CLOSURES, json={"proposals": proposals})
    assert answer.status_code == 200, answer.text
    same, next_one, elsewhere = answer.json()["closures"]
    assert same["verdict"] == "accepted"
    assert (same["turn_deg"], same["forward_m"], same["lateral_m"]) == (0.0, 0.0, 0.0)
    assert next_one["forward_m"] == pytest.approx(1.5, abs=0.5)  # a tenth of a second on
    assert elsewhere["verdict"] == "rejected"
    scans = recording().scans
    expected = check_scans(scans[3], scans[25], 1.73)
    assert elsewhere["overlap"] == expected.overlap
    assert elsewhere["probability"] == expected.probability
    assert elsewhere["signature_distance"] is None


def signature_closures(client, first_rows):
    """Check the signature of scan 3, with other noise, against stored scans."""
    second = signatures_of(client, recording(noise_seed=7).scans[3])
    body = {"proposals": [{"first": stored(row), "second": second} for row in first_rows]}
    answer = client.post(CLOSURES, json=body)
    assert answer.status_code == 200, answer.text
    return answer.json()["closures"]


def test_a_signature_is_compared_by_the_calibration_of_the_map(client):
    same, elsewhere = signature_closures(client, (3, 25))
    assert same["signature_distance"] < elsewhere["signature_distance"]
    assert same["probability"] > 0.9 > elsewhere["probability"]
    assert same["overlap"] is None


def test_a_signature_has_no_probability_in_a_map_without_calibration(empty):
    upload(empty, "monday", recording(scans=6))
    job = empty.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
    revision = wait_for(empty, job)["revision"]
    facts = empty.get(f"/v1/maps/campus/revisions/{revision}").json()
    assert facts["parameters"]["calibrated"] is False
    same, other = signature_closures(empty, (3, 0))
    assert same["signature_distance"] < other["signature_distance"]
    assert (same["probability"], same["verdict"]) == (None, "undecided")


def test_a_threshold_decides_what_is_accepted(client):
    body = {"proposals": [{"first": stored(3), "second": stored(5)}]}
    [strict] = client.post(CLOSURES, json={**body, "accept_from": 1.0}).json()["closures"]
    [loose] = client.post(CLOSURES, json={**body, "accept_from": 0.51}).json()["closures"]
    assert strict["probability"] == loose["probability"]
    assert strict["verdict"] == "undecided"
    assert loose["verdict"] == "accepted"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"proposals": []}, (422, "invalid-request")),
        ({"accept_from": 0.5}, (422, "invalid-request")),
        ({"sensor_height_m": 0}, (422, "invalid-request")),
        ({"proposals": [{"first": stored(3)}]}, (422, "invalid-request")),
        ({"proposals": [{"first": stored(3), "second": {"drive": 7}}]}, (422, "invalid-request")),
        (
            {"proposals": [{"first": stored(3, "friday"), "second": stored(4)}]},
            (404, "drive-not-found"),
        ),
        ({"proposals": [{"first": stored(3), "second": stored(99)}]}, (404, "scan-not-found")),
    ],
)
def test_an_impossible_proposal_is_refused(client, change, problem):
    body = {"proposals": [{"first": stored(3), "second": stored(4)}], **change}
    assert problem_of(client.post(CLOSURES, json=body)) == problem


def test_signatures_that_cannot_be_compared_are_refused(client):
    second = signatures_of(client, recording().scans[3])

    def answer(first, second):
        return client.post(CLOSURES, json={"proposals": [{"first": first, "second": second}]})

    assert problem_of(answer(stored(99), second)) == (404, "scan-not-found")
    assert problem_of(answer(stored(3, "friday"), second)) == (404, "scan-not-found")
    stale = {**second, "basis": "0" * 64}
    assert problem_of(answer(stored(3), stale)) == (409, "stale-signature")
    other_segment = {**second, "signatures": second["signatures"][1:]}
    assert problem_of(answer(stored(3), other_segment)) == (422, "invalid-signature")


def test_a_fault_of_one_proposal_names_it_and_its_scans(client):
    """Among a hundred a client finds out which one to leave out."""
    good = {"first": stored(3), "second": stored(4)}
    signatures = signatures_of(client, recording().scans[3])
    stale = {**signatures, "basis": "0" * 64}
    for bad, scans in (
        ({"first": stored(3), "second": stored(99)}, "scan 3 of drive 'monday' and scan 99 of"),
        ({"first": stored(3, "friday"), "second": stored(4)}, "scan 3 of drive 'friday' and scan"),
        ({"first": stored(3), "second": stale}, "scan 3 of drive 'monday' and signatures: "),
    ):
        refused = client.post(CLOSURES, json={"proposals": [good, bad, good]}).json()
        assert refused["detail"].startswith(f"proposal 1 of {scans}"), refused["detail"]


def test_no_revision_is_needed_if_the_sensor_height_is_given(empty):
    for index, scan in enumerate(recording().scans[:2]):
        empty.put(
            f"/v1/maps/campus/drives/monday/scans/{index}",
            content=kitti(scan),
            headers={"Content-Type": "application/vnd.tensormap.kitti"},
        )
    body = {"proposals": [{"first": stored(0), "second": stored(1)}]}
    assert problem_of(empty.post(CLOSURES, json=body)) == (409, "no-live-revision")
    given = empty.post(CLOSURES, json={**body, "sensor_height_m": 1.73})
    assert given.status_code == 200
