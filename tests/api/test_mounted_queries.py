"""Queries of mounted sensors, of several scans that become one, and checks of stored ones."""

import io
import tarfile
from dataclasses import asdict

import numpy as np
import pytest

from core.loop_closure.closure import check_scans
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from tests.support.campus import MAP, build, localize
from tests.support.mounted import ASKEW, mounted_recording, tilted, vehicle_poses
from tests.support.recording import KITTI, TAR, Recording, kitti, recording, tar
from tests.support.service import problem_of, running, upload

TEXT = "1.1,-0.4,1.9,3,-6,120"
LEANING = Tilt(roll_deg=-5.0, pitch_deg=8.0)
ONE_TUM = ("poses.tum", b"0 0 0 0 0 0 0 1")


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A service whose map is of a mounted sensor."""
    with running(tmp_path_factory.mktemp("mounted") / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        client.put(f"{MAP}/drives/askew", json={"mounting": asdict(ASKEW)})
        upload(client, "askew", Recording(tuple(mounted_recording())))
        build(client, segments=2, lateral_renderings_m=[0.0])
        yield client


def csv(scans, rows=None):
    """Return the odometry of scans as `poses.csv`."""
    rows = vehicle_poses() if rows is None else rows
    lines = [",".join(map(str, [scan, *rows[scan].tolist()])) for scan in scans]
    return "poses.csv", "\n".join(["scan,x,y,z,qx,qy,qz,qw", *lines]).encode()


def several(scans, *poses, sparse=True):
    """Return a query of several scans of the mounted sensor."""
    drive = mounted_recording(sparse=sparse)
    files = [(f"{index:06}.bin", kitti(drive.scan(index))) for index in scans]
    return tar([*files, *poses])


def few(scans, returns):
    """Return a query of scans of so few returns each, with poses."""
    files = [(f"{i}.bin", kitti(Scan(np.full((returns, 3), 9.0)))) for i in range(scans)]
    return tar([*files, csv(range(min(scans, 48)))])


def linked(name):
    """Return a query of one link."""
    body = io.BytesIO()
    with tarfile.open(fileobj=body, mode="w") as archive:
        link = tarfile.TarInfo(name)
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(link)
    return body.getvalue()


def far():
    """Return poses a kilometre apart."""
    rows = vehicle_poses().copy()
    rows[:, 0] = 1000.0 * np.arange(len(rows))
    return rows


def near(pose, index, within_m=2.0):
    x_m, y_m = vehicle_poses()[index, :2]
    return np.hypot(pose["x_m"] - x_m, pose["y_m"] - y_m) < within_m


def test_the_answer_is_the_vehicles_pose(client):
    content = kitti(mounted_recording().scan(20))
    found = localize(client, "scan", content=content, headers=KITTI, params={"mounting": TEXT})
    assert found["best"]["scan_index"] == 20
    assert found["best"]["pose"]["z_m"] == pytest.approx(0.0, abs=1e-9)
    assert near(found["best"]["pose"], 20, 1e-6)
    assert found["best"]["turn_deg"] == pytest.approx(0.0, abs=0.5)


def test_another_sensor_of_the_fleet_is_answered_too(client):
    content = kitti(recording().scans[20])
    found = localize(
        client, "scan", content=content, headers=KITTI, params={"mounting": "0,0,1.73"}
    )
    assert near(found["best"]["estimated_pose"], 20)


def test_several_scans_with_odometry_are_one_query(client):
    scans = range(13, 21)
    body = several(scans, csv(scans))
    found = localize(
        client, "scan", content=body, headers=TAR, params={"mounting": TEXT, "format": "kitti"}
    )
    assert near(found["best"]["estimated_pose"], 20)


def test_odometry_comes_in_every_format_of_poses(client):
    scans = range(16, 21)
    rows = vehicle_poses()[16:21]
    tum = "\n".join(" ".join(map(str, [t, *row])) for t, row in enumerate(rows.tolist()))
    options = {"headers": TAR, "params": {"mounting": TEXT, "format": "kitti"}}
    by_csv, by_tum = (
        localize(client, "scan", content=several(scans, poses), **options)
        for poses in (csv(range(21)), ("some/poses.tum", tum.encode()))
    )
    assert by_csv["matches"] == by_tum["matches"]


def test_a_mounting_and_a_height_exclude_each_other(client):
    content = kitti(recording().scans[20])
    for params in (
        {"mounting": TEXT, "sensor_height_m": 1.9},
        {"mounting": "1,2"},
        {"mounting": "0,0,-1"},
    ):
        answer = client.post(
            f"{MAP}/localizations/scan", content=content, headers=KITTI, params=params
        )
        assert problem_of(answer) == (422, "invalid-parameters")


@pytest.mark.parametrize(
    ("body", "problem", "detail"),
    [
        (lambda: b"", "empty-body", "wanted a tar"),
        (lambda: b"x" * 512, "malformed-upload", "checksum"),
        (lambda: tar([]), "malformed-upload", "has no file"),
        (lambda: several([1, 2]), "invalid-pose", "wanted one of poses.kitti"),
        (lambda: several([1, 2], csv([1])), "invalid-pose", "no line of scan 2"),
        (lambda: several([1], csv([1]), ("poses.tum", b"")), "invalid-pose", "poses.csv and"),
        (lambda: several([1], csv([1]), csv([1])), "invalid-pose", "poses.csv comes twice"),
        (lambda: linked("poses.csv"), "invalid-pose", "poses.csv of the tar: it is a link"),
        (lambda: linked("000001.npy"), "malformed-scan", "000001.npy: it is a link"),
        (lambda: several([1, 2], ONE_TUM), "invalid-pose", "has 1 line,"),
        (lambda: several([1, 2], ("poses.csv", b"a,b")), "invalid-pose", "line 1"),
        (lambda: several([1, 1], csv([1])), "invalid-scan", "scan 1 comes twice"),
        (lambda: several([1, 2], csv([1, 2], far())), "invalid-scan", "wanted at most 100"),
        (lambda: tar([("a.bin", b"x")]), "unknown-format", "is no index"),
        (lambda: tar([("a/1.bin", b"x")]), "truncated-scan", "a/1.bin: the body has 1 byte,"),
        (lambda: tar([("1.bin", bytes(32))]), "too-few-returns", "1.bin: "),
        (lambda: few(65, 1), "invalid-scan", "more than 64 scans"),
        (lambda: few(3, 33), "too-few-returns", "99 returns of 3 scans"),
    ],
)
def test_scans_that_cannot_become_one_are_rejected(client, body, problem, detail):
    answer = client.post(
        f"{MAP}/localizations/scan", content=body(), headers=TAR, params={"format": "kitti"}
    )
    assert problem_of(answer) == (422 if problem != "unknown-format" else 415, problem)
    assert detail in answer.json()["detail"]


def test_the_format_of_a_single_scan_is_that_of_its_type_or_the_named_one(client):
    scan = kitti(recording().scans[3])
    for headers in ({}, {"Content-Type": "application/octet-stream"}, KITTI):
        found = localize(client, "scan", content=scan, headers=headers, params={"format": "kitti"})
        assert found["best"]["scan_index"] == 3
    refused = client.post(
        f"{MAP}/localizations/scan", content=scan, headers=KITTI, params={"format": "pcd"}
    )
    assert problem_of(refused) == (422, "invalid-parameters")
    assert "format is pcd, the Content-Type is application/vnd.tensormap.kitti" in refused.text


def test_gravity_levels_what_sees_no_ground(client):
    """The mounting says how the sensor is on the vehicle, gravity how the vehicle is tilted."""
    scan = mounted_recording().scan(20)

    def distance(tilt, **params):
        found = localize(
            client,
            "scan",
            content=kitti(tilted(scan, tilt)),
            headers=KITTI,
            params={"mounting": TEXT, **params},
        )
        return found["best"]["distance"]

    level = distance(Tilt(0.0, 0.0))
    assert distance(LEANING, **vars(LEANING)) == pytest.approx(level, abs=1e-3)
    assert distance(LEANING) > 2.0 * level


def test_a_track_takes_gravity_too(client):
    content = kitti(tilted(mounted_recording().scan(20), LEANING))

    def distance(**params):
        track = client.post(f"{MAP}/tracks").headers["Location"]
        answer = client.post(
            f"{track}/observations",
            content=content,
            headers=KITTI,
            params={"mounting": TEXT, **params},
        )
        assert answer.status_code == 200, answer.text
        return answer.json()["distance"]

    assert distance(**vars(LEANING)) < 0.5 * distance()


@pytest.mark.parametrize(
    ("params", "problem"),
    [
        ({"roll_deg": 1.0}, "invalid-parameters"),
        ({"pitch_deg": 1.0}, "invalid-parameters"),
        ({"roll_deg": 45.1, "pitch_deg": 0}, "invalid-request"),
        ({"roll_deg": 0, "pitch_deg": -46}, "invalid-request"),
        ({"roll_deg": "nan", "pitch_deg": 0}, "invalid-request"),
        ({"roll_deg": 0, "pitch_deg": "inf"}, "invalid-request"),
        ({"roll_deg": "left", "pitch_deg": 0}, "invalid-request"),
    ],
)
def test_what_is_no_tilt_is_rejected(client, params, problem):
    content = kitti(recording().scans[20])
    track = client.post(f"{MAP}/tracks").headers["Location"]
    for url in (f"{MAP}/localizations/scan", f"{track}/observations"):
        answer = client.post(url, content=content, headers=KITTI, params=params)
        assert problem_of(answer) == (422, problem)


def test_a_format_that_is_not_known_is_rejected(client):
    content = kitti(recording().scans[20])
    answer = client.post(
        f"{MAP}/localizations/scan", content=content, headers=KITTI, params={"format": "gif"}
    )
    assert problem_of(answer) == (422, "invalid-request")


def test_few_returns_of_each_are_enough_together(client):
    answer = client.post(
        f"{MAP}/localizations/scan",
        content=few(4, 33),
        headers=TAR,
        params={"format": "kitti", "mounting": "0,0,1.73"},
    )
    assert answer.status_code == 200, answer.text


def test_a_track_takes_mounted_and_accumulated_observations(client):
    track = client.post(f"{MAP}/tracks").headers["Location"]
    params = {"mounting": TEXT, "format": "kitti"}
    for last in range(15, 40, 4):
        scans = range(last - 7, last + 1)
        answer = client.post(
            f"{track}/observations",
            content=several(scans, csv(scans)),
            headers=TAR,
            params=params,
        )
        assert answer.status_code == 200, answer.text
    step = answer.json()
    assert step["localized"]
    assert near(step["pose"], last, 3.0)
    answer = client.post(f"{track}/observations", content=several([1]), headers=TAR, params=params)
    assert problem_of(answer) == (422, "invalid-pose")


def test_stored_scans_are_compared_as_the_vehicle_sees_them(client):
    first, second = (ASKEW.mount(mounted_recording().scan(i), 1.73) for i in (10, 11))
    expected = check_scans(first, second, 1.73)
    stored = [{"drive": "askew", "scan_index": index} for index in (10, 11)]
    body = {"proposals": [{"first": stored[0], "second": stored[1]}]}
    [found] = client.post(f"{MAP}/loop-closures", json=body).json()["closures"]
    assert found["verdict"] == "accepted"
    assert found["overlap"] == pytest.approx(expected.overlap)
    assert found["forward_m"] == pytest.approx(1.5, abs=0.5)  # the vehicle's step, ahead
    assert found["lateral_m"] == pytest.approx(0.0, abs=0.5)
