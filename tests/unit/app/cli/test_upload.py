"""What an upload that Ctrl-C or the service ends says of the rest."""

import re

import pytest
import typer
from tensormap_client import OtherDrive, Unreachable
from tensormap_client.problems import StorageFull, TooManyRequests

from app.cli import upload as command
from app.cli.errors import CommandFailed
from storage.errors import InvalidSlug
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.samples import sample_drive

URL = "http://127.0.0.1:9"


class Interrupted:
    """A mapper that is interrupted in its upload or build."""

    at = ""
    error: BaseException = KeyboardInterrupt()

    def __init__(self, *_):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def upload(self, source, drive, progress):
        progress.start("hashing", 2)
        progress.advance()
        self.end("hash")
        progress.start("uploading", len(source))
        progress.move_to(2)
        self.end("upload")

    def drive(self, slug):
        return {"scans": 3, "scans_with_pose": 3}

    def start_build(self, parameters):
        return {"job": "abc"}

    def finish_build(self, job, progress):
        self.end("build")

    def end(self, part):
        if self.at == part:
            raise self.error


@pytest.mark.parametrize(
    ("at", "rest"),
    [
        ("hash", "nothing was done"),
        ("upload", "uploading: 2 of 3 done; the same command continues"),
        ("build", f"build /v1/jobs/abc continues on the service; DELETE {URL}/v1/jobs/abc"),
    ],
)
def test_an_interrupted_upload_names_what_remains(tmp_path, monkeypatch, capsys, at, rest):
    write_kitti_drive(sample_drive(3), tmp_path / "monday")
    monkeypatch.setattr(command, "Mapper", type("At", (Interrupted,), {"at": at}))
    monkeypatch.setattr(command, "_show_upload", lambda *_: None)
    with pytest.raises(typer.Exit) as ended:
        command.upload(tmp_path / "monday", f"{URL}/", "campus", "monday", build=True)
    assert ended.value.exit_code == 130
    assert f"tensormap: {rest}" in capsys.readouterr().err


@pytest.mark.parametrize("at", ["upload", "build"])
@pytest.mark.parametrize(
    "error",
    [
        Unreachable(f"{URL} cannot be reached"),
        TooManyRequests("PUT: 429", 429, "too-many-requests", "wait"),
        StorageFull("PUT: 507", 507, "storage-full", "no space"),
    ],
)
def test_an_upload_that_the_service_ends_names_what_remains(tmp_path, monkeypatch, at, error):
    write_kitti_drive(sample_drive(3), tmp_path / "monday")
    monkeypatch.setattr(command, "Mapper", type("At", (Interrupted,), {"at": at, "error": error}))
    monkeypatch.setattr(command, "_show_upload", lambda *_: None)
    rest = {
        "upload": "; uploading: 2 of 3 done; the same command continues",
        "build": f"; build /v1/jobs/abc continues on the service; DELETE {URL}/v1/jobs/abc",
    }[at]
    with pytest.raises(CommandFailed, match=re.escape(f"{error}{rest}")):
        command.upload(tmp_path / "monday", URL, "campus", "monday", build=True)


def test_an_upload_that_does_not_begin_does_not_say_that_it_continues(tmp_path):
    write_kitti_drive(sample_drive(3), tmp_path / "monday")
    with pytest.raises(CommandFailed, match=r"Connection refused$"):
        command.upload(tmp_path / "monday", URL, "campus", "monday")


def test_an_upload_that_can_never_succeed_does_not_say_that_it_continues(tmp_path, monkeypatch):
    write_kitti_drive(sample_drive(3), tmp_path / "monday")
    parts = {"at": "upload", "error": OtherDrive("drive 'monday' has a scan 7")}
    monkeypatch.setattr(command, "Mapper", type("At", (Interrupted,), parts))
    with pytest.raises(CommandFailed, match=r"^drive 'monday' has a scan 7$"):
        command.upload(tmp_path / "monday", URL, "campus", "monday")


def test_a_map_is_not_created_for_a_drive_that_cannot_be_named_so(tmp_path, monkeypatch):
    write_kitti_drive(sample_drive(3), tmp_path / "monday")
    created = []

    class Creating(Interrupted):
        def create_map(self):
            created.append("campus")

    monkeypatch.setattr(command, "Mapper", Creating)
    with pytest.raises(InvalidSlug, match="'Ä' is no slug"):
        command.upload(tmp_path / "monday", URL, "campus", "Ä", create=True)
    assert created == []


@pytest.mark.parametrize(
    ("live", "shown"),
    [
        (True, "live\n"),
        (False, "not live: PUT http://127.0.0.1:9/v1/maps/campus/live makes it so\n"),
    ],
)
def test_a_build_that_is_not_live_names_the_request_that_makes_it_so(
    tmp_path, monkeypatch, capsys, live, shown
):
    class Built(Interrupted):
        def finish_build(self, job, progress):
            return {"revision": "5e", "gate": None, "notes": []}

        def revision(self, name):
            return {"live": live, "scans": 3, "segments": 1}

    write_kitti_drive(sample_drive(3), tmp_path / "monday")
    monkeypatch.setattr(command, "Mapper", Built)
    monkeypatch.setattr(command, "_show_upload", lambda *_: None)
    command.upload(tmp_path / "monday", URL, "campus", "monday", build=True)
    assert f"revision 5e: 3 scans in 1 segment, {shown}" in capsys.readouterr().out
