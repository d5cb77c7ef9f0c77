"""`tensormap verify`, and `backup` of what it finds: what they print, and how they end."""

import pytest
from typer.testing import CliRunner

from app.cli.main import cli
from core.errors import InvalidParameters
from storage.errors import DataDirInUse, StorageUnavailable
from storage.files.claims import claimed
from storage.store import Store
from tests.support.catalog_rows import stored_scans
from tests.support.small_scans import sample_scan

pytestmark = pytest.mark.slow


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    with Store(folder) as store:
        store.maps.create("campus")
        for index in range(3):
            store.drives.put_scan("campus", "monday", index, sample_scan(index))
    return folder


def ran(data, *options):
    result = CliRunner().invoke(cli, ["verify", "--data", str(data), *options])
    return result.exit_code, result.stdout, result.exception


def test_a_sound_store_is_one_line_and_no_failure(data):
    assert ran(data)[:2] == (0, f"{data}: 3 files checked, 0 damaged or missing\n")


def test_each_finding_is_a_line_and_a_loss_is_a_failure(data):
    damaged, gone, _ = sorted(data.rglob("chunks/*.h5"))
    with Store(data) as store:
        scans = {r.chunk: r.index for r in stored_scans(store, "campus", "monday")}
    of_drive = "map campus, drive monday, scan"
    damaged.write_bytes(damaged.read_bytes()[:-100])
    gone.unlink()
    (data / "maps" / ".x.1.part").touch()
    status, printed, _ = ran(data)
    lines = printed.splitlines()
    assert status == 1
    assert len(lines) == 4
    assert lines[0].startswith(f"damaged: {of_drive} {scans[damaged.name]}: ")
    assert lines[0].endswith(f" ({damaged.relative_to(data)})")
    where = gone.relative_to(data)
    assert lines[1] == f"missing: {of_drive} {scans[gone.name]}: the file is gone ({where})"
    assert lines[2] == "left over: maps/.x.1.part: half-written"
    assert lines[3] == f"{data}: 3 files checked, 2 damaged or missing"
    status, printed, _ = ran(data, "--repair")
    assert (status, "; moved to damaged/" in printed) == (1, True)
    assert "half-written (removed)" in printed
    with Store(data) as store:
        logged = store.audit.list().items[-1]
    assert (logged.key_id, logged.action, logged.outcome) == ("operator", "repair_files", "done")
    assert logged.detail.startswith(f"1 file, the first {damaged.relative_to(data)}: moved to")
    status, printed, _ = ran(data)
    assert (status, printed.count("missing: ")) == (1, 2)


def test_leftover_files_alone_are_no_failure(data):
    (data / "maps" / "stray").touch()
    assert ran(data)[0] == 0
    assert ran(data, "--repair")[0] == 0
    assert ran(data)[:2] == (0, f"{data}: 3 files checked, 0 damaged or missing\n")
    [kept] = (data / "orphans").glob("*/maps/stray")
    assert kept.is_file()


def test_files_that_a_repair_could_not_remove_are_reported(data):
    part = data / "maps" / ".x.1.part"
    part.touch()
    with claimed(lambda: part):  # as by a process that still writes it
        status, printed, _ = ran(data, "--repair")
    assert status == 0
    assert "half-written (left: it is in use, or is not this user's)" in printed
    assert part.exists()
    assert "half-written (removed)" in ran(data, "--repair")[1]
    assert not part.exists()


def test_a_folder_that_is_no_data_directory_is_not_changed(tmp_path):
    status, _, error = ran(tmp_path)
    assert (status, type(error)) == (1, StorageUnavailable)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_repaired_beside_a_server(data):
    with Store.serving(data):
        status, _, error = ran(data, "--repair")
        assert (status, type(error)) == (1, DataDirInUse)
        assert ran(data)[0] == 0


def test_a_damaged_catalog_is_reported(data):
    catalog = data / "catalog.sqlite3"
    content = bytearray(catalog.read_bytes())
    at = content.rindex(b"campus")  # of a row and of an index: one of them now differs
    content[at] ^= 1
    catalog.write_bytes(content)
    status, printed, _ = ran(data)
    assert (status, "damaged: catalog: " in printed) == (1, True)


def test_an_incomplete_backup_names_its_file_and_fails(data, tmp_path):
    whole, beside = tmp_path / "b.tar", tmp_path / "b.incomplete.tar"
    backup = ["backup", "--data", str(data), "-o", str(whole)]
    first = CliRunner().invoke(cli, backup)
    assert (first.exit_code, first.stderr) == (0, "copying: 3 of 3\n")
    next(data.rglob("chunks/*.h5")).unlink()
    second = CliRunner().invoke(cli, backup)
    assert (second.exit_code, second.stdout.partition(":")[0]) == (1, str(beside))
    assert f"incomplete: it is in {beside}, and {whole} is unchanged" in second.stderr


def test_a_repair_by_another_user_is_rejected(data, monkeypatch):
    monkeypatch.setattr("os.geteuid", lambda: data.stat().st_uid + 1)
    _, _, error = ran(data, "--repair")
    assert isinstance(error, InvalidParameters)
    assert "belongs to user" in str(error)
    assert not (data / "damaged").exists()
