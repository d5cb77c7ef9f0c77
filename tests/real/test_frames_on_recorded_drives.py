"""Drives in one world frame and in two, of recorded scans."""

import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.arrays import FloatArray
from core.encodings.registry import encoding_names
from core.frames.agreement import FrameCheck, check_frames
from core.mapping.fit import fit_map
from core.mapping.placement import Placement
from core.parameters import MapParameters
from core.projection.images import ConcatenatedImages, project_drive
from core.scans.drive import Drive
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.topology import cut_at_meetings
from tests.support.recorded_drives import Drives
from tests.support.recording import kitti, tar
from tests.support.service import Client, copy_of, running, wait_for

pytestmark = pytest.mark.real_data

MAP = "/v1/maps/campus"
EVEN, QUERIED = range(0, 120, 2), range(1, 120, 6)


def moved(rows: FloatArray, turn_deg: float, x_m: float) -> FloatArray:
    """Return `(n, 7)` poses as another survey would give them."""
    turn, poses = Rotation.from_euler("z", turn_deg, degrees=True), rows.copy()
    poses[:, :3] = turn.apply(poses[:, :3]) + np.array([x_m, 0.0, 0.0])
    poses[:, 3:] = (turn * Rotation.from_quat(poses[:, 3:])).as_quat()
    return poses


def upload(client: Client, name: str, drive: Drive, scans: range, poses: FloatArray) -> None:
    files = tar((f"{i:06}.bin", kitti(drive.scan(scan))) for i, scan in enumerate(scans))
    sent = client.post(
        f"{MAP}/drives/{name}/scans",
        content=files,
        headers={"Content-Type": "application/x-tar"},
        params={"format": "kitti"},
    )
    assert sent.status_code == 200, sent.text
    placed = [{"scan": i, "pose": row} for i, row in enumerate(poses.tolist())]
    assert client.put(f"{MAP}/drives/{name}/poses", json={"poses": placed}).status_code == 200


def build(client: Client, **parameters: Any) -> Any:
    return wait_for(client, client.post(f"{MAP}/builds", json=parameters).json()["job"])


def localized(client: Client, drive: Drive, scans: range) -> int:
    answers = [
        client.post(
            f"{MAP}/localizations/scan",
            content=kitti(drive.scan(scan)),
            headers={"Content-Type": "application/vnd.tensormap.kitti"},
        ).json()
        for scan in scans
    ]
    return sum(answer["localized"] for answer in answers)


@pytest.fixture(scope="module")
def mapped(drives: Drives, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stopped service's data with a map of even scans, which answers odd ones."""
    data_dir = tmp_path_factory.mktemp("even") / "data"
    kitti00 = drives.open("kitti00")
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "a", kitti00, EVEN, kitti00.poses[list(EVEN)])
        assert build(client, segments=3)["state"] == "done"
        assert localized(client, kitti00, QUERIED) == len(QUERIED)
    return data_dir


@pytest.mark.xdist_group("mapped")
def test_odd_scans_of_kitti00_in_another_frame_are_refused_or_aligned_to_the_map_of_the_even_ones(
    drives: Drives, mapped: Path, tmp_path: Path
) -> None:
    kitti00, odd = drives.open("kitti00"), range(1, 120, 2)
    right = kitti00.poses[list(odd)]
    with running(copy_of(mapped, tmp_path / "data")) as client:
        upload(client, "b", kitti00, odd, moved(right, 30.0, 500.0))
        job = build(client, base="live", add=["b"], make_live=True)
        assert (localized(client, kitti00, QUERIED), job["state"]) == (len(QUERIED), "failed")
        assert job["error"]["type"] == "/problems/frames-disagree"
        detail = job["error"]["detail"]
        [turned_deg] = re.findall(r"turned by (\S+) deg", detail)
        assert float(turned_deg) == pytest.approx(-30.0, abs=0.5)
        assert "scan 0 matches" in detail
        job = build(client, base="live", add=["b"], align="auto", make_live=True)
        assert (job["state"], job["gate"]["live"]) == ("done", True)
        aligned = localized(client, kitti00, QUERIED)
        placed = [{"scan": i, "pose": row} for i, row in enumerate(right.tolist())]
        client.put(f"{MAP}/drives/b/poses", json={"poses": placed})
        job = build(client, base="live", add=["b"], make_live=True)  # without the transform
        anew = "drive b is in the base already: its scans are read, and its poses placed, anew"
        assert (job["state"], job["notes"], job["gate"]["live"]) == ("done", [anew], True)
        assert aligned >= localized(client, kitti00, QUERIED) >= 19


@pytest.mark.xdist_group("mapped")
def test_odd_scans_of_kitti00_that_are_moved_by_20_metres_do_not_reach_the_map(
    drives: Drives, mapped: Path, tmp_path: Path
) -> None:
    kitti00, odd = drives.open("kitti00"), range(1, 120, 2)
    with running(copy_of(mapped, tmp_path / "data")) as client:
        upload(client, "b", kitti00, odd, moved(kitti00.poses[list(odd)], 0.0, 20.0))
        job = build(client, base="live", add=["b"], make_live=True)
        assert job["error"]["type"] == "/problems/frames-disagree"


def test_the_passes_of_nclt_turn_in_independent_frames_are_aligned(
    drives: Drives, tmp_path: Path
) -> None:
    drive = drives.open("nclt_turn")
    there, back = range(93), range(93, 186)
    turn_deg, x_m = -110.0, 700.0
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "a", drive, there, drive.poses[list(there)])
        upload(client, "b", drive, back, moved(drive.poses[list(back)], turn_deg, x_m))
        job = build(client, align="auto", sensor="hdl-32e", sensor_height_m=0.95)
        assert job["state"] == "done"
        revision = client.get(f"{MAP}/revisions/{job['revision']}").json()
    found = Placement.from_attributes(revision["parameters"]["placements"]["b"])
    assert found.others == ("a",)
    centre_m = np.array(found.centre_m)  # of the overlap
    as_given = moved(np.array([[*centre_m, 0.0, 0.0, 0.0, 1.0]]), turn_deg, x_m)[:, :3]
    off_m = np.linalg.norm((found.transform.apply(as_given) - centre_m)[0, :2])
    assert off_m <= 0.3
    assert abs(found.transform.yaw_deg + turn_deg) <= 1.0


Part = tuple[str, range, Callable[[FloatArray], FloatArray]]


@functools.lru_cache(2)
def projected_scans(drives: Drives, parameters: MapParameters, name: str, scans: range) -> Any:
    drive, rendered = drives.open(name), drives.rendered(name, parameters)
    imager = parameters.imager
    return project_drive(drive, np.array(scans), imager, most_probes=0, rendered=rendered)


def checked(drives: Drives, encoding: str, first: Part, second: Part) -> FrameCheck:
    parts, trajectories = [], []
    for number, (name, scans, change) in enumerate((first, second)):
        drive = drives.open(name)
        height_m = 0.95 if name == "nclt_turn" else 1.73
        parameters = MapParameters.for_sensor(encoding=encoding, sensor_height_m=height_m)
        projected = projected_scans(drives, parameters, name, scans)
        parts.append(projected.images)
        kept = projected.scans
        trajectories.append(
            Trajectory.of_drive(
                f"{number}", drive.timestamp_s[kept], change(drive.poses[kept]), kept
            )
        )
    trajectory = Trajectory.concatenate(trajectories)
    tensor_map = fit_map(
        ConcatenatedImages(parts),
        trajectory,
        cut_at_meetings(trajectory, cut_drives(trajectory.drive_start, 50)),
        parameters,
    )
    (check,) = check_frames(tensor_map)
    return check


def as_they_are(poses: FloatArray) -> FloatArray:
    return poses


@pytest.mark.parametrize("encoding", encoding_names())
@pytest.mark.parametrize(("name", "x_m"), [("kitti00", 2.0), ("kitti_drive0001", 0.0)])
def test_even_and_odd_scans_are_in_one_frame(
    drives: Drives, encoding: str, name: str, x_m: float
) -> None:
    scans = len(drives.open(name))
    even, odd = range(0, scans, 2), range(1, scans, 2)
    check = checked(
        drives, encoding, (name, even, as_they_are), (name, odd, lambda p: moved(p, 0.0, x_m))
    )
    assert check.met, str(check)


def test_passes_of_one_street_in_opposite_directions_are_in_one_frame_or_not(
    drives: Drives,
) -> None:
    halves = range(93), range(93, 186)
    passes = [("nclt_turn", half, as_they_are) for half in halves]
    assert checked(drives, "harmonic", *passes).met
    rotated: Part = ("nclt_turn", halves[1], lambda poses: moved(poses, 30.0, 500.0))
    found = checked(drives, "harmonic", passes[0], rotated).transform
    assert found is not None
    assert found.yaw_deg == pytest.approx(-30.0, abs=3.0)


@pytest.mark.parametrize("encoding", encoding_names())
@pytest.mark.parametrize("other", ["kit_muehlburger", "kitti_drive0001"])
def test_drives_of_two_towns_are_not_found_to_disagree(
    drives: Drives, encoding: str, other: str
) -> None:
    whole = [(name, range(len(drives.open(name))), as_they_are) for name in ("kitti00", other)]
    for first, second in (whole, whole[::-1]):
        check = checked(drives, encoding, first, second)
        assert check.disagreement is None
        assert not check.met
