"""Many scans in one body."""

import errno
import gzip
import io
import tarfile

import numpy as np
import pytest

from app.drives import scan_group
from app.drives.scan_upload import ScanUpload
from app.drives.tar_stream import TarFeed
from app.http.bodies.incoming import Incoming
from app.http.errors import BodyTooLarge
from app.settings import Settings
from storage.files.files import named_disk_errors
from tests.support.recording import KITTI, TAR, kitti, npy, recording, tar
from tests.support.service import problem_of, running, whole_store

SCANS = recording(scans=6).scans
DRIVE = "/v1/maps/campus/drives/monday"


@pytest.fixture
def empty(emptied):
    return emptied


def npy_files(indices=range(6)):
    return [(f"{index:06}.npy", npy(SCANS[index].points_m)) for index in indices]


def upload_of(client, settings):
    store = client.service.store
    return ScanUpload(store, settings, "campus", "monday", require_sender=lambda: None)


def ranges(*pairs):
    return [{"first": first, "last": last} for first, last in pairs]


def test_what_an_archive_holds_is_stored_bit_for_bit_and_a_second_time_is_there(empty):
    files = [(f"velodyne/{i:06}.bin", kitti(scan)) for i, scan in enumerate(SCANS) if i != 3]
    first = empty.post(
        f"{DRIVE}/scans", content=tar(files), headers=TAR, params={"format": "kitti"}
    ).json()
    assert (first["scans_stored"], first["scans_present"], first["files_set_aside"]) == (5, 0, 0)
    assert first["stored"] == ranges((0, 2), (4, 5))
    answer = empty.get(f"{DRIVE}/scans").json()
    assert (answer["scans"], answer["closed"]) == (5, False)
    assert (answer["present"], answer["gaps"]) == (ranges((0, 2), (4, 5)), ranges((3, 3)))
    before = whole_store(empty)
    again = empty.post(f"{DRIVE}/scans", content=tar(files), params={"format": "kitti"}).json()
    assert (again["scans_stored"], again["present"]) == (0, ranges((0, 2), (4, 5)))
    assert whole_store(empty) == before
    for index in (0, 1, 2, 4, 5):
        got = np.load(io.BytesIO(empty.get(f"{DRIVE}/scans/{index}").content))
        assert got.tobytes() == SCANS[index].points_m.tobytes()


def test_unusable_files_are_set_aside_with_their_reason_and_the_others_are_stored(empty):
    empty.post(f"{DRIVE}/scans", content=tar(npy_files([4])))
    files = [
        ("000000.npy", npy(SCANS[0].points_m)),
        ("000001.npy", npy(SCANS[1].points_m)[:-5]),
        ("000002.bin", kitti(SCANS[2])),
        ("readme.txt", b"hello"),
        ("000003.npy", npy(SCANS[3].points_m[:9])),
        ("000004.npy", npy(SCANS[3].points_m)),
        ("000005.xyz", b"1 2 3"),
        ("99999999999.npy", npy(SCANS[0].points_m)),
        ("000007.npy", npy(SCANS[0].points_m * 1000)),
        ("000006.npy", b""),
        ("5.npy", npy(SCANS[5].points_m)),
    ]
    answer = empty.post(f"{DRIVE}/scans", content=tar(files), headers=TAR).json()
    assert answer["stored"] == ranges((0, 0), (5, 5))
    assert answer["files_set_aside"] == 9
    assert [
        (item["file"], item["type"].removeprefix("/problems/")) for item in answer["set_aside"]
    ] == [
        ("000001.npy", "truncated-scan"),
        ("000002.bin", "unknown-format"),
        ("readme.txt", "unknown-format"),
        ("000003.npy", "too-few-returns"),
        ("000005.xyz", "unknown-format"),
        ("99999999999.npy", "unknown-format"),
        ("000007.npy", "wrong-dtype"),
        ("000006.npy", "empty-body"),
        ("000004.npy", "scan-conflict"),
    ]
    assert "?format=kitti" in answer["set_aside"][1]["detail"]
    assert answer["set_aside"][4]["detail"] == (
        "no format has the suffix '.xyz'; if it is one of another suffix, name it, as ?format=csv"
    )
    assert empty.get(f"{DRIVE}/scans").json()["present"] == ranges((0, 0), (4, 5))


def test_a_named_format_is_of_the_files_whose_suffix_says_none(empty):
    files = [
        ("000000.bin", kitti(SCANS[0])),
        *npy_files([1]),
        ("000002.bin", npy(SCANS[2].points_m)),
        ("000003.dat", kitti(SCANS[3])),
    ]
    answer = empty.post(f"{DRIVE}/scans", content=tar(files), params={"format": "kitti"}).json()
    assert answer["stored"] == ranges((0, 1), (3, 3))
    [refused] = answer["set_aside"]
    assert (refused["file"], refused["type"]) == ("000002.bin", "/problems/malformed-scan")
    got = np.load(io.BytesIO(empty.get(f"{DRIVE}/scans/1").content))
    assert got.tobytes() == SCANS[1].points_m.tobytes()


def test_a_downloaded_scan_has_the_name_of_a_file_so_that_a_browser_saves_it(empty):
    empty.post(f"{DRIVE}/scans", content=tar(npy_files([1])))
    got = empty.get(f"{DRIVE}/scans/1")
    assert got.headers["Content-Disposition"] == 'attachment; filename="campus-monday-1.npy"'


def test_an_upload_of_which_nothing_can_be_used_is_a_problem_that_lists_its_files(empty):
    files = [("000000.bin", kitti(SCANS[0])), ("readme.txt", b"hello"), ("1.npy", b"no scan")]
    refused = empty.post(f"{DRIVE}/scans", content=tar(files), headers=TAR)
    assert problem_of(refused) == (422, "nothing-stored")
    assert [(item["file"], item["type"]) for item in refused.json()["set_aside"]] == [
        ("000000.bin", "/problems/unknown-format"),
        ("readme.txt", "/problems/unknown-format"),
        ("1.npy", "/problems/malformed-scan"),
    ]
    detail = refused.json()["detail"]
    assert "0 of 3 files can be used" in detail
    assert "000000.bin: records in .bin may be KITTI's" in detail
    assert problem_of(empty.get(DRIVE)) == (404, "drive-not-found")


def test_of_many_unusable_files_a_thousand_are_listed_and_all_are_counted(empty):
    files = [(f"{index}.xyz", b"1 2 3") for index in range(1002)]
    refused = empty.post(f"{DRIVE}/scans", content=tar(files), headers=TAR).json()
    assert len(refused["set_aside"]) == 1000
    assert "0 of 1002 files can be used" in refused["detail"]


def test_an_upload_that_repeats_a_stored_scan_is_no_problem_whatever_else_is_in_it(empty):
    empty.post(f"{DRIVE}/scans", content=tar(npy_files([0])))
    sent = empty.post(f"{DRIVE}/scans", content=tar([*npy_files([0]), ("1.npy", b"no scan")]))
    assert sent.status_code == 200
    assert (sent.json()["scans_present"], sent.json()["files_set_aside"]) == (1, 1)


def test_an_index_that_is_no_number_of_a_scan_is_rejected(empty):
    for index in (10**9, 99999999999, 2**53 - 1):
        refused = empty.put(f"{DRIVE}/scans/{index}", content=kitti(SCANS[0]), headers=KITTI)
        assert problem_of(refused) == (422, "invalid-parameters")
        assert f"the scan index is {index}, wanted less than 1000000000" in refused.json()["detail"]
    assert problem_of(empty.get(DRIVE)) == (404, "drive-not-found")
    last = empty.put(f"{DRIVE}/scans/{10**9 - 1}", content=kitti(SCANS[0]), headers=KITTI)
    assert last.status_code == 201


@pytest.mark.parametrize("style", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_names_may_be_long_and_links_and_folders_are_no_scans(empty, style):
    body = io.BytesIO()
    with tarfile.open(fileobj=body, mode="w", format=style) as archive:
        folder = tarfile.TarInfo("ä" * 40 + "/velodyne")
        folder.type = tarfile.DIRTYPE
        link = tarfile.TarInfo("000001.npy")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        long_name = tarfile.TarInfo("a" * 90 + "/" + "b" * 60 + "/000000.npy")
        content = npy(SCANS[0].points_m)
        long_name.size = len(content)
        for member in (folder, link):
            archive.addfile(member)
        archive.addfile(long_name, io.BytesIO(content))
    answer = empty.post(f"{DRIVE}/scans", content=body.getvalue(), headers=TAR).json()
    assert answer["stored"] == ranges((0, 0))
    [aside] = answer["set_aside"]
    assert (aside["file"], aside["type"]) == ("000001.npy", "/problems/malformed-scan")
    assert aside["detail"].endswith("it is a link or device, no file")


def test_a_closed_drive_takes_what_it_has_and_nothing_else(empty):
    empty.post(f"{DRIVE}/scans", content=tar(npy_files([0, 1])))
    empty.patch(DRIVE, json={"closed": True})
    answer = empty.post(f"{DRIVE}/scans", content=tar(npy_files([0, 1, 2]))).json()
    assert answer["present"] == ranges((0, 1))
    assert [item["type"] for item in answer["set_aside"]] == ["/problems/drive-closed"]
    assert empty.get(f"{DRIVE}/scans").json()["closed"] is True
    refused = empty.post(f"{DRIVE}/scans", content=tar(npy_files([2])))
    assert problem_of(refused) == (422, "nothing-stored")
    assert [item["type"] for item in refused.json()["set_aside"]] == ["/problems/drive-closed"]


def test_scans_before_a_limit_was_reached_are_stored(empty, tmp_path):
    body = tar(npy_files())

    def pieces():
        yield from (body[at : at + 999] for at in range(0, len(body) // 2, 999))
        raise BodyTooLarge("in the middle of a body that unpacks to too many bytes")

    settings = Settings(data_dir=tmp_path, min_returns=1)
    upload = upload_of(empty, settings)
    with pytest.raises(BodyTooLarge):
        upload.take(pieces())
    assert empty.get(f"{DRIVE}/scans").json()["present"] == ranges((0, 2))


@pytest.mark.parametrize("cut", [100, 512, 700, -1024 - 100])
def test_an_incomplete_archive_is_reported_and_earlier_scans_are_stored(empty, cut):
    whole = tar(npy_files([0, 1]))
    second = whole.index(b"000001.npy")
    end = second + cut if cut > 0 else len(whole.rstrip(b"\0")) - 400
    refused = empty.post(f"{DRIVE}/scans", content=whole[:end], headers=TAR)
    assert problem_of(refused) == (422, "malformed-upload")
    assert "1 scan stored before" in refused.json()["detail"]
    assert empty.get(f"{DRIVE}/scans").json()["present"] == ranges((0, 0))


@pytest.mark.parametrize("kept", [0, 512, 1024, None])
def test_that_an_archive_has_no_mark_of_its_end_is_noted_as_it_may_be_cut_off(empty, kept):
    whole = tar(npy_files([0, 1]))
    files = len(whole.rstrip(b"\0"))
    end = None if kept is None else files + -files % 512 + kept
    answer = empty.post(f"{DRIVE}/scans", content=whole[:end], headers=TAR).json()
    assert answer["stored"] == ranges((0, 1))
    if kept == 0:
        assert len(answer["notes"]) == 1
        assert "ends after '000001.npy' without the zeros" in answer["notes"][0]
    else:
        assert answer["notes"] == []


@pytest.mark.parametrize("second", ["tuesday/velodyne", "monday/velodyne/more", ""])
def test_scans_of_several_folders_are_stored_with_a_note(empty, second):
    folders = ["monday/velodyne"] * 3 + [second] * 3
    files = [(f"{of}/{name}", body) for of, (name, body) in zip(folders, npy_files(), strict=True)]
    answer = empty.post(f"{DRIVE}/scans", content=tar(files), headers=TAR).json()
    assert answer["scans_stored"] == 6
    assert len(answer["notes"]) == 1
    assert "'monday/velodyne/000002.npy' and '" in answer["notes"][0]
    assert f"{second}/000003.npy'" in answer["notes"][0]
    one = [(f"./monday/velodyne/{name}", body) for name, body in npy_files([0, 1])]
    one[0] = (one[0][0].removeprefix("./"), one[0][1])
    assert empty.post(f"{DRIVE}/scans", content=tar(one), headers=TAR).json()["notes"] == []


@pytest.mark.parametrize("at", ["a group", "the last group", "a long file", "the spool"])
def test_an_archive_that_fills_the_disk_says_how_many_scans_are_stored(
    empty, monkeypatch, caplog, at
):
    scans = empty.service.store.drives
    put, calls = scans.put_scans, []

    def full(*_args, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    def put_or_fail(*args, **options):
        calls.append(args)
        if len(calls) == (2 if at == "a group" else 3):
            with named_disk_errors():
                full()
        return put(*args, **options)

    monkeypatch.setattr(scan_group, "_GROUP_SCANS", 2)
    if at == "the spool":
        fill = Incoming.fill

        async def fill_and_fail(*args, **options):
            await fill(*args, **options)
            with named_disk_errors():
                full()

        monkeypatch.setattr(Incoming, "fill", fill_and_fail)
    elif at == "a long file":
        take, taken = TarFeed.take, []

        def take_and_fail(*args):
            for member in take(*args):
                yield member
                taken.append(member)
                if len(taken) == 3:  # the third waits for a group: it still fits
                    full()

        monkeypatch.setattr(TarFeed, "take", take_and_fail)
    else:
        monkeypatch.setattr(scans, "put_scans", put_or_fail)
    refused = empty.post(f"{DRIVE}/scans", content=tar(npy_files()), headers=TAR)
    assert problem_of(refused) == (507, "storage-full")
    drive = empty.get(DRIVE)
    stored = drive.json()["scans"] if drive.status_code == 200 else 0
    assert stored == {"a group": 2, "the last group": 4, "a long file": 3}.get(at, stored)
    assert f"{stored} scans stored before" in refused.json()["detail"]
    assert "send the archive again" in refused.json()["detail"]
    [line] = [record for record in caplog.records if "no space is left" in record.getMessage()]
    assert line.exc_info is None
    monkeypatch.undo()
    again = empty.post(f"{DRIVE}/scans", content=tar(npy_files()), headers=TAR).json()
    assert (again["scans_stored"], again["scans_present"]) == (len(SCANS) - stored, stored)


def header(name=b"000000.npy", size=b"00000000010\0", kind=b"0"):
    block = name.ljust(100, b"\0") + b"0000644\0" + b"0000000\0" * 2 + size.ljust(12, b"\0")
    block += b"0" * 12 + b" " * 8 + kind
    block = block.ljust(512, b"\0")
    return block[:148] + b"%06o\0 " % sum(block) + block[156:]


@pytest.mark.parametrize(
    "body",
    [
        b"",
        bytes(1024),
        b"hello",
        kitti(SCANS[0]),
        header(size=b"\x80" + b"\xff" * 11),
        header(size=b"zzz"),
        header(size=b"77777777777"),
        header(kind=b"x", size=b"77777777777"),
        header(kind=b"L", size=b"00001000000"),
        header(kind=b"5"),
    ],
)
def test_an_invalid_archive_is_rejected_and_changes_nothing(empty, body):
    before = whole_store(empty)
    refused = empty.post(f"{DRIVE}/scans", content=body, headers=TAR)
    assert problem_of(refused) == (422, "malformed-upload")
    assert whole_store(empty) == before


def test_a_file_that_is_too_long_is_passed_over_unread(tmp_path):
    with running(tmp_path / "data", max_body_bytes=20_000) as client:
        client.post("/v1/maps", json={"map": "campus"})
        small = npy(SCANS[0].points_m[:200])
        body = tar([("0.npy", npy(np.ones((9_000, 3), np.float32))), ("1.npy", small)])
        assert len(body) > 100_000  # the archive itself may be longer than one scan
        answer = client.post(f"{DRIVE}/scans", content=body, headers=TAR).json()
        assert answer["stored"] == ranges((1, 1))
        assert answer["set_aside"][0]["type"] == "/problems/scan-too-large"


def test_an_upload_has_a_limit_of_its_own(tmp_path):
    with running(tmp_path / "data", max_upload_bytes=20_000) as client:
        client.post("/v1/maps", json={"map": "campus"})
        body = tar(npy_files([0, 1]))
        for content in (body, (body[i : i + 999] for i in range(0, len(body), 999))):
            refused = client.post(f"{DRIVE}/scans", content=content, headers=TAR)
            assert problem_of(refused) == (413, "body-too-large")
        packed = gzip.compress(bytes(10**6))
        refused = client.post(
            f"{DRIVE}/scans", content=packed, headers={**TAR, "Content-Encoding": "gzip"}
        )
        assert problem_of(refused) == (413, "body-too-large")


def test_a_missing_drive_or_wrong_type_is_rejected_before_the_body_is_read(empty):
    def post(path, **options):
        return problem_of(empty.post(path, content=tar(npy_files([0])), **options))

    assert post("/v1/maps/none/drives/monday/scans") == (404, "map-not-found")
    assert post("/v1/maps/campus/drives/No%20Slug/scans") == (422, "invalid-slug")
    assert post(f"{DRIVE}/scans", headers=KITTI) == (415, "unsupported-body")
    assert post(f"{DRIVE}/scans", params={"format": "bag"}) == (415, "unknown-format")
    assert problem_of(empty.get(f"{DRIVE}/scans")) == (404, "drive-not-found")


@pytest.mark.parametrize("index", ["+1", "%201", "1_0", "1.0", "-1", "%D9%A1"])
def test_an_index_is_written_in_digits_alone(empty, index):
    put = empty.put(f"{DRIVE}/scans/{index}", content=kitti(SCANS[0]), headers=KITTI)
    assert problem_of(put) == (422, "invalid-request")
    assert empty.get(f"{DRIVE}").status_code == 404


def test_of_scans_of_one_index_the_first_is_stored_and_the_others_are_set_aside(empty):
    one, other, third = (npy(scan.points_m) for scan in SCANS[:3])
    files = [("0.npy", one), ("1.npy", third), ("0.npy", one), ("0.npy", other), ("2.npy", one)]
    sent = empty.post(f"{DRIVE}/scans", content=tar(files), headers=TAR).json()
    assert (sent["scans_stored"], sent["files_set_aside"]) == (3, 1)
    (aside,) = sent["set_aside"]
    assert (aside["file"], aside["type"]) == ("0.npy", "/problems/scan-conflict")
    files = [("0.npy", other), ("3.npy", one)]
    again = empty.post(f"{DRIVE}/scans", content=tar(files), headers=TAR).json()
    assert (again["scans_stored"], again["files_set_aside"]) == (1, 1)
