"""Folders as recordings are: named by times, or KITTI's with what lies beside the scans."""

import gzip
import io
import random
import tarfile
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from app.drives.scan_upload import ScanUpload
from app.http.bodies.incoming import Pace
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from tests.support.recording import TAR, npy, recording, tar
from tests.support.samples import sample_drive
from tests.support.service import problem_of, running

SCANS = recording(scans=6).scans
DRIVE = "/v1/maps/campus/drives/monday"
TIMES = ["1679000000.100000", "1679000000.200000", "1679000000.95", "1679000001.0"]


@pytest.fixture
def empty(emptied):
    return emptied


def named(names, first=0):
    return [(f"{name}.npy", npy(SCANS[first + at].points_m)) for at, name in enumerate(names)]


def post(client, files, **options):
    options.setdefault("headers", TAR)
    return client.post(f"{DRIVE}/scans", content=tar(files), **options)


def refused(response):
    assert problem_of(response) == (422, "malformed-upload")
    return response.json()["detail"]


def stored(client):
    """Return the digests and times of the scans, by index."""
    drive = client.service.store.drives.open("campus", "monday")
    return {
        int(index): (digest, float(time_s))
        for index, digest, time_s in zip(
            drive.scan_index, drive.digests, drive.timestamp_s, strict=True
        )
    }


@pytest.mark.parametrize("seed", range(3))
def test_scans_named_by_times_are_stored_in_order_of_time_whatever_their_order(empty, seed):
    files = named(TIMES)
    shuffled = random.Random(seed).sample(files, len(files))
    answer = post(empty, shuffled)
    assert answer.json()["stored"] == [{"first": 0, "last": 3}]
    found = stored(empty)
    assert [time_s for _, time_s in found.values()] == [float(time) for time in TIMES]
    for index in range(4):
        got = empty.get(f"{DRIVE}/scans/{index}")
        assert npy(SCANS[index].points_m) == got.content
    again = post(empty, files).json()
    assert (again["scans_stored"], again["scans_present"]) == (0, 4)
    assert stored(empty) == found


def test_nanoseconds_are_times_and_a_packed_body_is_ordered_too(empty):
    names = ["1561000444500000000", "1561000444390857630"]
    packed = gzip.compress(tar(named(names)))
    headers = {**TAR, "Content-Encoding": "gzip"}
    answer = empty.post(f"{DRIVE}/scans", content=packed, headers=headers)
    assert answer.json()["scans_stored"] == 2
    assert [time_s for _, time_s in stored(empty).values()] == [1561000444.3908576, 1561000444.5]


def test_times_since_1970_may_be_of_any_unit(empty):
    names = ["1561000446", "1561000444390", "1561000444390858", "1561000444500000000"]
    assert post(empty, named(names)).json()["scans_stored"] == 4
    times_s = [time_s for _, time_s in stored(empty).values()]
    assert times_s == [1561000444.39, 1561000444.390858, 1561000444.5, 1561000446.0]


@pytest.fixture
def in_pieces(monkeypatch):
    """Let bodies arrive as over a network: the test's client sends each one whole."""
    receive_next = Pace.next
    left: list[bytes] = []

    async def next_piece(pace, receive):
        if not left:
            message = await receive_next(pace, receive)
            body = message["body"]
            left.extend(body[at : at + 2**20] for at in range(0, max(1, len(body)), 2**20))
        piece = left.pop(0)
        return {"type": "http.request", "body": piece, "more_body": bool(left)}

    monkeypatch.setattr(Pace, "next", next_piece)


@pytest.mark.usefixtures("in_pieces")
@pytest.mark.parametrize("names", [TIMES, ["0", "1", "2", "3"]], ids=["times", "indices"])
def test_files_of_any_size_that_are_no_scans_may_come_before_scans(empty, names):
    stray = [("report.pdf", bytes(9 * 2**20)), ("sensor.json", b"{}")]
    answer = post(empty, [*stray, *named(names)])
    assert answer.json()["stored"] == [{"first": 0, "last": 3}], answer.text
    assert answer.json()["files_set_aside"] == 2


@pytest.mark.usefixtures("in_pieces")
def test_before_scans_named_by_indices_there_may_be_more_than_what_is_kept_of_a_body(tmp_path):
    stray = ("report.pdf", bytes(20 * 2**20))
    with running(tmp_path / "data", max_spool_bytes=16 * 2**20) as client:
        client.post("/v1/maps", json={"map": "campus"})
        answer = post(client, [stray, *named(["0", "1"])])
    assert answer.json()["stored"] == [{"first": 0, "last": 1}], answer.text


def test_later_scans_follow_and_missing_ones_take_their_place(empty):
    files = named(TIMES)
    post(empty, files)
    whole = stored(empty)
    empty.delete(DRIVE)
    post(empty, files[:2])
    assert post(empty, files[2:]).json()["stored"] == [{"first": 2, "last": 3}]
    assert stored(empty) == whole


def test_of_an_upload_that_is_repeated_unusable_files_keep_their_place(empty):
    files = named(TIMES)
    broken = [files[0], (files[1][0], b"no scan"), *files[2:]]
    assert post(empty, broken).json()["files_set_aside"] == 1
    assert sorted(stored(empty)) == [0, 2, 3]
    assert post(empty, files).json()["stored"] == [{"first": 1, "last": 1}]


def test_a_scan_before_stored_ones_without_an_index_left_is_an_error(empty):
    post(empty, named(TIMES[1:]))
    found = refused(post(empty, named(TIMES)))
    assert "1679000000.100000.npy is before scan 0" in found
    assert len(stored(empty)) == 3


def test_uploads_to_one_drive_at_once_are_stored_one_after_the_other(empty, monkeypatch):
    order, second_begun = ScanUpload.order_by_time, threading.Event()
    with ThreadPoolExecutor(1) as pool:
        later: list[Future[Any]] = []

        def order_while_another_comes(upload, read):
            if later:
                second_begun.set()
            order(upload, read)
            if not later:
                later.append(pool.submit(post, empty, named(TIMES[2:], first=2)))
                second_begun.wait(timeout=1.0)  # it waits until this one is stored

        monkeypatch.setattr(ScanUpload, "order_by_time", order_while_another_comes)
        answers = [post(empty, named(TIMES[:2])), later[0].result()]
    assert [answer.json()["files_set_aside"] for answer in answers] == [0, 0]
    found = stored(empty)
    assert sorted(found) == [0, 1, 2, 3]
    assert [time_s for _, time_s in found.values()] == [float(name) for name in TIMES]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["1.5", "0003"], ["1.5.npy", "0003.npy", "nothing was stored"]),
        (["1.5", "1.7", "a/1.50"], ["1.5.npy", "a/1.50.npy", "the same time"]),
        (["0003", "1.5"], ["'1.5.npy'", "'0003.npy'"]),
    ],
)
def test_mixed_and_colliding_names_are_an_error_with_both(empty, names, words):
    found = refused(post(empty, named(names)))
    for word in words:
        assert word in found


def test_times_continue_a_drive_of_indices_once_its_scans_have_times(empty):
    post(empty, named(["0", "1"]))
    found = refused(post(empty, named(TIMES)))
    assert "scan 0 of the drive has no time" in found
    assert "set times with PUT .../poses" in found
    first_s = min(map(float, TIMES))
    times = [{"scan": scan, "timestamp_s": first_s - 9.0 + scan} for scan in (0, 1)]
    put = empty.put("/v1/maps/campus/drives/monday/poses", json={"poses": times})
    assert put.status_code == 200, put.text
    assert post(empty, named(TIMES)).json()["scans_stored"] == len(TIMES)
    assert sorted(stored(empty)) == list(range(2 + len(TIMES)))


@pytest.fixture
def folder(tmp_path):
    drive = sample_drive(4, returns=200)
    write_kitti_drive(drive, tmp_path / "monday")
    return tmp_path / "monday"


def files_of(folder):
    """Return the files of a folder by name, as `tar` lists them, images included."""
    found = [
        (f"./{file.relative_to(folder)}", file.read_bytes())
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    ]
    return [*found, ("./image_0/000000.png", b"\x89PNG....")]


def require_same(client, folder):
    recorded, uploaded = open_drive(folder), client.service.store.drives.open("campus", "monday")
    np.testing.assert_array_equal(uploaded.timestamp_s, recorded.timestamp_s)
    np.testing.assert_array_equal(uploaded.poses, recorded.poses)
    for index in range(len(recorded)):
        np.testing.assert_array_equal(uploaded.scan(index).points_m, recorded.scan(index).points_m)


TR = "P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n"


@pytest.mark.parametrize("calibration", ["", TR])
@pytest.mark.parametrize("order", [1, -1])
def test_a_folder_of_kitti_is_read_from_a_tar_as_by_the_commands(empty, folder, calibration, order):
    if calibration:
        (folder / "calib.txt").write_text(calibration)
    answer = post(empty, files_of(folder)[::order]).json()
    assert (answer["scans_stored"], answer["files_set_aside"]) == (4, 1)
    assert answer["set_aside"][0]["file"] == "./image_0/000000.png"
    assert answer["poses"]["set"] == 4
    require_same(empty, folder)
    assert post(empty, files_of(folder)).json()["poses"]["replaced"] == 0


@pytest.mark.parametrize("repeated", ["calib.txt", "poses.txt", "times.txt"])
def test_of_two_drives_in_an_archive_no_poses_are_set(empty, folder, repeated):
    (folder / "calib.txt").write_text(TR)
    files = files_of(folder)
    other = next(body for name, body in files if name == f"./{repeated}")
    answer = post(empty, [*files, (f"./tuesday/{repeated}", other)]).json()
    assert (answer["scans_stored"], answer["poses"]) == (4, None)
    aside = {item["file"]: item for item in answer["set_aside"] if "image" not in item["file"]}
    names = {"./calib.txt", "./poses.txt", "./times.txt", f"./tuesday/{repeated}"}
    assert set(aside) == names
    for item in aside.values():
        assert item["type"] == "/problems/malformed-drive"
        assert f"has ./{repeated} and ./tuesday/{repeated}" in item["detail"]
    twice = [*files, (repeated, other)]  # as `tar -r` replaces a file
    assert post(empty, twice).json()["poses"]["set"] == 4


def test_times_alone_are_set_and_keep_poses(empty, folder):
    files = files_of(folder)
    post(empty, files)
    mark = "\ufeff"  # that editors of Windows write
    later = f"{mark}100\n101\n102\n103\n".encode()
    answer = post(empty, [("times.txt", later), files[-2]]).json()
    assert answer["poses"] is None
    assert [time_s for _, time_s in stored(empty).values()] == [100.0, 101.0, 102.0, 103.0]
    assert empty.get(DRIVE).json()["scans_with_pose"] == 4


def test_comments_between_times_are_left_out_and_lines_keep_their_numbers(empty, folder):
    post(empty, files_of(folder))
    times = b"# seconds\n100\n101 # late\n102\n # of the clock\n103\n"
    assert post(empty, [("times.txt", times)]).status_code == 200
    assert [time_s for _, time_s in stored(empty).values()] == [100.0, 101.0, 102.0, 103.0]
    late = times.replace(b"103", b"1679000000000000000")
    refused = post(empty, [("times.txt", late)])
    assert "line 6: the time is" in refused.text


def test_an_unknown_time_leaves_the_stored_one(empty, folder):
    post(empty, files_of(folder))
    for known in (b"100\n101\n102\n103\n", b"200\nnan\nnan\n203\n"):
        assert post(empty, [("times.txt", known)]).status_code == 200
    assert [time_s for _, time_s in stored(empty).values()] == [200.0, 101.0, 102.0, 203.0]


@pytest.mark.parametrize(
    ("file", "content", "kind", "message"),
    [
        ("poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n", "poses-do-not-fit", "has 1 line,"),
        ("poses.txt", b"1 0 0\n", "invalid-pose", "line 1"),
        ("calib.txt", b"P0: 1\n", "malformed-drive", "no line 'Tr:'"),
        ("times.txt", b"0.3\n0.2\n0.1\n0.0\n", "invalid-pose", "times that rise"),
        ("times.txt", b"0.1\n0.2\n", "invalid-pose", "has 2 lines"),
        ("times.txt", b"noon\n", "malformed-drive", "line 1"),
        ("times.txt", b"0\n1679000000000000000\n2\n3\n", "invalid-pose", "line 2: the time is"),
        ("times.txt", b"12\n" * 72_001, "invalid-pose", "has 72001 lines"),
        ("times.txt", b"12\n" * 2_000_000, "malformed-drive", "has more than 4608000 bytes"),
        ("poses.txt", b"1\n" * 20_000_000, "malformed-drive", "has more than 36864000 bytes"),
        ("calib.txt", b"P0: 1\n" * 20_000, "malformed-drive", "has more than 65536 bytes"),
    ],
    ids=range(11),
)
def test_what_does_not_fit_is_set_aside_and_the_scans_are_stored(
    empty, folder, file, content, kind, message
):
    (folder / file).write_bytes(content)
    answer = post(empty, files_of(folder)[:-1]).json()
    assert answer["scans_stored"] == 4
    [aside] = answer["set_aside"]
    assert aside["file"] == ("./poses.txt" if file == "calib.txt" else f"./{file}")
    assert aside["type"] == f"/problems/{kind}"
    assert message in aside["detail"]


@pytest.mark.parametrize("name", ["poses.txt", "times.txt", "calib.txt"])
def test_a_link_or_too_large_a_file_is_set_aside_as_such_whatever_its_name(tmp_path, name):
    body = io.BytesIO()
    with tarfile.open(fileobj=body, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        link = tarfile.TarInfo(name)
        link.type, link.linkname = tarfile.SYMTYPE, "../poses/00.txt"
        archive.addfile(link)
    files = tar([(f"other/{name}", bytes(2**20 + 1)), *named(["0"])])
    with running(tmp_path / "data", max_body_bytes=2**20) as client:
        client.post("/v1/maps", json={"map": "campus"})
        content = body.getvalue()[:512] + files
        answer = client.post(f"{DRIVE}/scans", content=content, headers=TAR).json()
    assert answer["scans_stored"] == 1, answer
    assert [(aside["file"], aside["type"], aside["detail"]) for aside in answer["set_aside"]] == [
        (name, "/problems/malformed-scan", "it is a link or device, no file"),
        (
            f"other/{name}",
            "/problems/scan-too-large",
            "it has 1048577 bytes, at most 1048576 are read",
        ),
    ]


def test_times_alone_may_come_in_an_archive(empty, folder):
    files = dict(files_of(folder))
    times = files.pop("./times.txt")
    post(empty, files.items())
    answer = post(empty, [("times.txt", times)])
    assert answer.status_code == 200, answer.text
    assert {time_s for _, time_s in stored(empty).values()} == {float(t) for t in times.split()}


def test_a_calibration_without_poses_is_set_aside(empty, folder):
    calibration = dict(files_of(folder)).get("./calib.txt", b"Tr: 1 0 0 0 0 1 0 0 0 0 1 0")
    refused = post(empty, [("calib.txt", calibration)])
    assert problem_of(refused) == (422, "nothing-stored")
    assert "poses.txt" in refused.json()["set_aside"][0]["detail"]


def test_what_to_do_with_poses_of_other_scans_is_not_cut_off(empty, folder):
    files = files_of(folder)
    post(empty, files)
    lines = dict(files)["./poses.txt"].splitlines(keepends=True)
    refused = post(empty, [("poses.txt", b"".join(2 * lines[::-1]))]).json()
    [aside] = refused["set_aside"]
    assert aside["type"] == "/problems/poses-do-not-fit"
    assert aside["detail"].endswith("if its last ones were left out, partial=true sets the others")
    assert aside["detail"] in refused["detail"]


def test_poses_alone_may_come_in_an_archive(empty, folder):
    files = dict(files_of(folder))
    poses = files.pop("./poses.txt")
    post(empty, files.items())
    assert post(empty, [("poses.txt", poses)]).json()["poses"]["set"] == 4


def test_the_folder_of_another_drive_changes_no_pose_and_no_time(empty, folder, tmp_path):
    files = files_of(folder)
    post(empty, files)
    before = empty.get(f"{DRIVE}/poses").json()
    write_kitti_drive(sample_drive(4, seed=8, returns=200), tmp_path / "other")
    other = dict(files_of(tmp_path / "other"))
    other["./times.txt"] = b"5\n6\n7\n8\n"
    other["./poses.txt"] = b"".join(reversed(other["./poses.txt"].splitlines(keepends=True)))
    scan = next(name for name in other if name.endswith("000000.bin"))
    refused = post(empty, other.items())
    assert problem_of(refused) == (422, "nothing-stored")
    aside = {item["file"]: item for item in refused.json()["set_aside"]}
    for name in ("./poses.txt", "./times.txt"):
        assert aside[name]["type"] == "/problems/poses-do-not-fit"
        assert f"4 scans of the archive, the first in {scan}, are not" in aside[name]["detail"]
    assert empty.get(f"{DRIVE}/poses").json() == before
    mixed = post(empty, {**other, scan: dict(files)[scan]}.items()).json()
    assert (mixed["scans_present"], mixed["poses"]) == (1, None)
    assert empty.get(f"{DRIVE}/poses").json() == before
