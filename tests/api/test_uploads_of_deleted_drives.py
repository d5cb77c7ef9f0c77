"""Uploads whose drive is deleted meanwhile: nothing of them is stored in another drive."""

import pytest

from app.drives.scan_upload import ScanUpload
from app.settings import Settings
from storage.errors import DriveNotFound
from tests.support.recording import npy, recording, tar
from tests.support.service import problem_of, whole_store

SCANS = recording(scans=6).scans
DRIVE = "/v1/maps/campus/drives/monday"


def npy_files():
    return [(f"{index:06}.npy", npy(scan.points_m)) for index, scan in enumerate(SCANS)]


def upload_of(client, settings):
    store = client.service.store
    return ScanUpload(store, settings, "campus", "monday", require_sender=lambda: None)


def test_an_upload_whose_drive_is_deleted_ends_and_makes_no_second_drive(empty, tmp_path):
    upload = upload_of(empty, Settings(data_dir=tmp_path))
    body = tar(npy_files())
    upload.take([body[: len(body) // 2]])
    upload.store()
    assert empty.delete(DRIVE).status_code == 204
    upload.take([body[len(body) // 2 :]])
    with pytest.raises(DriveNotFound, match="deleted while its scans were stored"):
        upload.finish()
    assert problem_of(empty.get(DRIVE)) == (404, "drive-not-found")


def test_scans_ranked_by_time_among_those_of_a_drive_are_not_stored_in_another(empty, tmp_path):
    empty.post(f"{DRIVE}/scans", content=tar([("1.5.npy", npy(SCANS[0].points_m))]))
    upload = upload_of(empty, Settings(data_dir=tmp_path))
    body = tar([("2.5.npy", npy(SCANS[1].points_m))])
    upload.order_by_time(lambda: [body])
    assert empty.delete(DRIVE).status_code == 204
    upload.take([body])
    with pytest.raises(DriveNotFound, match="deleted while its scans were stored"):
        upload.finish()
    assert problem_of(empty.get(DRIVE)) == (404, "drive-not-found")


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize(
    ("file", "content"),
    [("poses.txt", b"1 0 0 5 0 1 0 0 0 0 1 0\n" * 6), ("times.txt", b"1\n2\n3\n4\n5\n6\n")],
)
def test_poses_and_times_of_an_archive_are_not_those_of_another_drive_of_that_name(
    empty, tmp_path, file, content, again
):
    upload = upload_of(empty, Settings(data_dir=tmp_path))
    upload.take([tar([*npy_files(), (file, content)])])
    upload.store()
    assert empty.delete(DRIVE).status_code == 204
    if again:
        empty.post(f"{DRIVE}/scans", content=tar(npy_files()))
    before = whole_store(empty)
    with pytest.raises(DriveNotFound, match="deleted while its scans were stored"):
        upload.finish()
    assert whole_store(empty) == before
