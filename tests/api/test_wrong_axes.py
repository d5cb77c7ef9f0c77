"""Answers to scans that are not localized note axes other than x forward, y left, z up."""

import numpy as np
import pytest

from app.http.answer_forms import PART_TYPE
from app.localization import all_maps, routes
from app.localization.answers import FIX
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.campus import MAP, PACKED, localize, signed
from tests.support.city import district
from tests.support.recording import KITTI, TAR, kitti, recording, tar
from tests.support.service import copy_of, running

UPSIDE_DOWN, CAMERA = [[1, 0, 0], [0, -1, 0], [0, 0, -1]], [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
X_UP = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
HANGING = "0,0,1.73,180,0,0"
CALIBRATED = {"segments": 3, "encoding": "harmonic"}


@pytest.fixture(scope="module", params=["one", "all"])
def query(request, tmp_path_factory, campus_of, city):
    """Posts a scan to one map, or to all maps of a service."""
    data = tmp_path_factory.mktemp("axes") / "data"
    built = campus_of(**CALIBRATED) if request.param == "one" else city
    path = f"{MAP if request.param == 'one' else '/v1'}/localizations/scan"
    with running(copy_of(built, data)) as client:

        def post(scan, **params):
            body, headers = (scan, TAR) if isinstance(scan, bytes) else (kitti(scan), KITTI)
            answer = client.post(path, content=body, headers=headers, params=params)
            assert answer.status_code == 200, answer.text
            return answer

        yield post


@pytest.fixture
def here(request):
    """Scans of places of these maps, recorded once more."""
    of_one = request.node.callspec.params["query"] == "one"
    again = recording(noise_seed=7) if of_one else district("north", noise_seed=5)
    return again.scans[4:40:6]


def elsewhere(scans=6):
    sensor = SimulatedSensor(firings=180)
    return list(SimulatedDrive(seed=77, scans=scans, speed_m_s=150.0, stops=False, sensor=sensor))


def turned(scan, rows):
    return Scan.from_returns(scan.points_m @ np.array(rows, np.float64).T)


@pytest.mark.parametrize(("rows", "axis"), [(UPSIDE_DOWN, "-z"), (CAMERA, "-y"), (X_UP, "+x")])
def test_scans_in_other_axes_are_noted_where_they_are_not_localized(query, here, rows, axis):
    answers = [query(turned(scan, rows)).json() for scan in here]
    assert not all(answer["localized"] for answer in answers)
    for answer in answers:
        said = [f"{axis} of the scan points up" in note for note in answer["notes"]]
        assert said == ([] if answer["localized"] else [True])


def test_scans_of_places_that_no_map_has_are_not_noted(query):
    answers = [query(scan).json() for scan in elsewhere()]
    assert {(answer["localized"], *answer["notes"]) for answer in answers} == {(False,)}


def test_what_is_localized_is_not_looked_at(query, here, monkeypatch):
    looked = []

    def noted(scan, *_, **_mounted):
        looked.append(scan)
        return ["axes"]

    for module in (routes, all_maps):
        monkeypatch.setattr(module, "axis_notes", noted)
    answers = [query(scan).json() for scan in here]
    assert sum(answer["localized"] for answer in answers) >= 4
    refused = [answer for answer in answers if not answer["localized"]]
    assert [answer["notes"] for answer in refused] == [["axes"]] * len(looked)
    assert all(answer["notes"] == [] for answer in answers if answer["localized"])


def test_a_mounting_that_turns_the_scan_is_right_and_one_that_turns_it_away_is_noted(query, here):
    scan = here[2]
    right = query(turned(scan, UPSIDE_DOWN), mounting=HANGING).json()
    assert (right["localized"], right["notes"]) == (True, [])
    wrong = query(scan, mounting=HANGING).json()
    assert not wrong["localized"]
    assert "-z of the scan points up as it is mounted" in wrong["notes"][0]
    refused = query(turned(scan, UPSIDE_DOWN), mounting=HANGING, min_probability=1.0).json()
    assert (refused["localized"], refused["notes"]) == (False, [])


def test_a_tilt_does_not_hide_the_axes(query, here):
    tilted = query(turned(here[2], UPSIDE_DOWN), roll_deg=-6.0, pitch_deg=8.0).json()
    assert "-z of the scan points up" in tilted["notes"][0]


def test_several_scans_that_become_one_are_looked_at_as_one(query, here):
    scan = turned(here[2], UPSIDE_DOWN)
    standing = "poses.csv", b"scan,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n"
    body = tar([("0.bin", kitti(scan)), ("1.bin", kitti(scan)), standing])
    [note] = query(body, format="kitti").json()["notes"]
    assert "-z of the scan points up" in note


def test_a_scan_of_few_returns_is_not_noted(query, here):
    whole_m = turned(here[2], UPSIDE_DOWN).points_m
    few = Scan(whole_m[np.abs(whole_m[:, 1]) < 0.1 * whole_m[:, 0]])
    answer = query(few).json()
    assert (answer["localized"], answer["notes"]) == (False, [])


def test_fields_choose_the_notes(query, here, monkeypatch):
    wrong = turned(here[2], CAMERA)
    part = query(wrong, fields="localized,notes")
    assert part.headers["content-type"] == PART_TYPE
    assert part.json() == {"localized": False, "notes": query(wrong).json()["notes"]}
    for module in (routes, all_maps):
        monkeypatch.setattr(module, "axis_notes", None)  # is not called
    assert query(wrong, fields="localized").json() == {"localized": False}


def test_packed_answers_and_answers_to_signatures_have_none(client, monkeypatch):
    monkeypatch.setattr(routes, "axis_notes", None)  # is not called
    body = kitti(turned(recording().scans[7], CAMERA))
    headers = KITTI | {"Accept": FIX.media_type}
    packed = client.post(f"{MAP}/localizations/scan", content=body, headers=headers)
    assert len(packed.content) == FIX.bytes
    live = client.get(MAP).json()["live_revision"]
    params = {"min_probability": 1.0}
    refused = localize(
        client, "signature", content=signed(client, live), headers=PACKED, params=params
    )
    assert (refused["localized"], refused["notes"]) == (False, [])
