"""Accepted and refused localizations, and priors, over HTTP."""

import pytest

from core.localization.localizer import Localizer
from storage.files.map_file import read_map
from tests.support.campus import localize
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running


@pytest.fixture(scope="module")
def client(tmp_path_factory, campus_of):
    built = campus_of(segments=3, encoding="harmonic")
    with running(copy_of(built, tmp_path_factory.mktemp("trust") / "data")) as client:
        yield client


def localized(client, query="", index=20):
    scan = recording(noise_seed=7).scans[index]
    return localize(client, f"scan?{query}", content=kitti(scan), headers=KITTI)


def test_an_answer_is_that_of_the_method(client):
    [revision] = client.get("/v1/maps/campus/revisions").json()["items"]
    assert revision["parameters"]["calibrated"]
    core = Localizer(read_map(revision_file(client.service.store, "campus", revision["revision"])))
    answer = localized(client)
    found = core.localize_scan(recording(noise_seed=7).scans[20])
    assert found.deviation is not None
    assert answer["localized"] is found.localized is True
    assert answer["reason"] is None
    assert answer["probability"] == found.decision.probability
    assert 0.5 <= answer["probability"] < 1.0
    deviations = [answer[name] for name in ("along_std_m", "lateral_std_m", "heading_std_deg")]
    deviation = found.deviation
    assert deviations == [deviation.along_m, deviation.lateral_m, deviation.heading_deg]
    assert tuple(answer["position_covariance"].values()) == found.position_covariance_m2


def test_a_refusal_is_an_answer_with_a_reason_and_the_candidates(client):
    answer = localized(client, "min_probability=1&k=3")
    assert answer["localized"] is False
    assert answer["reason"] in {"unknown_place", "ambiguous"}
    assert len(answer["matches"]) == 3


def test_priors_narrow_the_search_and_a_wrong_one_is_refused(client):
    place = localized(client)["best"]["pose"]
    x_m, y_m = place["x_m"], place["y_m"]
    right = localized(client, f"x_m={x_m}&y_m={y_m}&position_sigma_m=3")
    assert right["localized"]
    assert right["best"]["scan_index"] == localized(client)["best"]["scan_index"]
    for query in (
        f"x_m={x_m + 9000}&y_m={y_m}&position_sigma_m=3",
        f"since_x_m={x_m + 9000}&since_y_m={y_m}&travelled_m=5&travelled_sigma_m=1",
    ):
        wrong = localized(client, query)
        assert (wrong["localized"], wrong["reason"]) == (False, "outside_prior")
    by_scan = localized(
        client, "since_drive=monday&since_scan=19&travelled_m=2&travelled_sigma_m=1"
    )
    assert by_scan["best"]["scan_index"] == right["best"]["scan_index"]
    heading = localized(client, f"heading_deg={place['yaw_deg']}&heading_sigma_deg=5")
    assert abs(heading["best"]["turn_deg"]) <= 20.0
    assert {match["segment"] for match in localized(client, "segment=1&k=5")["matches"]} == {1}


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ("x_m=1", "invalid-parameters"),
        ("x_m=1&y_m=2", "invalid-parameters"),
        ("x_m=nan&y_m=2&position_sigma_m=1", "invalid-parameters"),
        ("x_m=1&y_m=2&position_sigma_m=0", "invalid-parameters"),
        ("heading_deg=1", "invalid-parameters"),
        ("travelled_m=1&travelled_sigma_m=1", "invalid-parameters"),
        ("since_drive=monday&travelled_m=1&travelled_sigma_m=1", "invalid-parameters"),
        ("since_drive=monday&since_scan=1", "invalid-parameters"),
        (
            "since_drive=monday&since_scan=1&since_x_m=1&since_y_m=1&travelled_m=1"
            "&travelled_sigma_m=1",
            "invalid-parameters",
        ),
        (
            "since_drive=sunday&since_scan=1&travelled_m=1&travelled_sigma_m=1",
            "invalid-parameters",
        ),
        ("segment=99", "unknown-segment"),
        ("segment=-1", "invalid-request"),
        ("min_probability=1.5", "invalid-request"),
        ("min_probability=nan", "invalid-request"),
    ],
)
def test_an_impossible_prior_is_refused_with_its_problem(client, query, problem):
    response = client.post(
        f"/v1/maps/campus/localizations/scan?{query}",
        content=kitti(recording().scans[0]),
        headers=KITTI,
    )
    assert problem_of(response) == (422, problem)
