"""`tensormap backup`: what it backs up, and the files that it does not replace."""

import tarfile
from pathlib import Path

import pytest

from storage.store import Store
from tests.support.commands import called
from tests.support.small_scans import sample_scan


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    with Store(folder) as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, sample_scan(0))
    return folder


def _contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "name",
    [
        "catalog.sqlite3",
        "catalog.sqlite3-wal",
        "catalog.sqlite3-tracks",
        "store-id",
        "server.lock",
        "clock.json",
        "maps/b.tar",
        "../data/store-id",
    ],
)
def test_a_backup_into_what_is_backed_up_is_refused(data, name) -> None:
    (data / "server.lock").touch()
    before = _contents(data)
    shown = called("backup", "--data", data, "-o", data / name, status=2, COLUMNS="300")
    assert f"{data / name} belongs to the data directory" in shown
    assert _contents(data) == before


def test_a_backup_into_maps_on_another_disk_is_refused(data, tmp_path) -> None:
    (data / "maps").rename(tmp_path / "disk")
    (data / "maps").symlink_to(tmp_path / "disk")
    at = data / "maps/b.tar"
    shown = called("backup", "--data", data, "-o", at, status=2, COLUMNS="300")
    assert f"{at} belongs to the data directory" in shown
    assert not at.exists()


def test_a_backup_to_a_link_into_what_is_backed_up_is_refused(data, tmp_path) -> None:
    (link := tmp_path / "b.tar").symlink_to(data / "maps" / "b.tar")
    shown = called("backup", "--data", data, "-o", link, status=2, COLUMNS="300")
    assert f"{data / 'maps' / 'b.tar'} belongs to the data directory" in shown
    assert link.is_symlink()


def test_a_backup_to_a_link_to_a_disk_that_is_not_mounted_is_refused(data, tmp_path) -> None:
    (link := tmp_path / "b.tar").symlink_to(tmp_path / "nas" / "b.tar")
    shown = called("backup", "--data", data, "-o", link, status=2, COLUMNS="300")
    assert f"there is no folder {tmp_path / 'nas'}" in shown
    assert link.is_symlink()
    (tmp_path / "nas").mkdir()
    shown = called("backup", "--data", data, "-o", link)
    assert f"{tmp_path / 'nas' / 'b.tar'}: 1 file" in shown
    assert link.is_symlink()


def test_a_file_that_is_no_backup_is_not_replaced(data, tmp_path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("of yesterday")
    shown = called("backup", "--data", data, "-o", notes, status=2, COLUMNS="300")
    assert "notes.txt is there already and is no backup" in shown
    assert notes.read_text() == "of yesterday"


def test_a_file_that_is_no_backup_is_not_replaced_by_an_incomplete_one(data, tmp_path) -> None:
    whole, notes = tmp_path / "b.tar", tmp_path / "b.incomplete.tar"
    notes.write_text("of yesterday")
    called("backup", "--data", data, "-o", whole)  # nothing is written beside the first one
    [scans] = data.rglob("chunks/*.h5")
    scans.unlink()
    shown = called("backup", "--data", data, "-o", whole, status=2, COLUMNS="300")
    assert "b.incomplete.tar is there already and is no backup" in shown
    assert notes.read_text() == "of yesterday"
    notes.unlink()
    for _ in range(2):  # an earlier incomplete backup is replaced
        called("backup", "--data", data, "-o", whole, status=1)


@pytest.mark.parametrize("folder", [".", "data"])
def test_an_earlier_backup_and_an_empty_file_are_replaced(data, tmp_path, folder) -> None:
    file = tmp_path / folder / "b.tar"
    file.touch()  # as by mktemp
    for _ in range(2):
        assert f"{file}: 1 file, " in called("backup", "--data", data, "-o", file)


@pytest.mark.parametrize("name", ["b.tar", "b.incomplete.tar"])
def test_a_backup_of_another_data_directory_is_not_replaced(data, tmp_path, name) -> None:
    with Store(tmp_path / "empty"):
        pass  # as of a service that starts while the disk of its data is not mounted
    called("backup", "--data", data, "-o", tmp_path / name)
    whole = tmp_path / "b.tar"
    if name != "b.tar":
        called("backup", "--data", tmp_path / "empty", "-o", whole)
    before = (tmp_path / name).read_bytes()
    refused = "backup", "--data", tmp_path / "empty", "-o", whole
    shown = called(*refused, status=2, COLUMNS="400")
    other = (data / "store-id").read_text().strip()
    assert f"{tmp_path / name} is there already and is a backup of another data" in shown
    assert f"of store {other}: wanted another name" in shown
    assert (tmp_path / name).read_bytes() == before
    (tmp_path / name).unlink()
    called("backup", "--data", tmp_path / "empty", "-o", whole)


def test_backups_of_a_restored_data_directory_replace_those_of_the_first_one(data, tmp_path):
    backup = tmp_path / "b.tar"
    called("backup", "--data", data, "-o", backup)
    called("restore", backup, "--data", tmp_path / "restored")
    called("backup", "--data", tmp_path / "restored", "-o", backup)


def test_a_backup_begins_with_the_id_of_its_store_and_an_earlier_one_ends_with_it(data, tmp_path):
    new, earlier = tmp_path / "new.tar", tmp_path / "earlier.tar"
    called("backup", "--data", data, "-o", new)
    with tarfile.open(new) as tar, tarfile.open(earlier, "w") as written:
        first, *others = tar.getmembers()
        assert first.name == "store-id"
        for member in (*others, first):
            written.addfile(member, tar.extractfile(member))
    with Store(tmp_path / "other"):
        pass
    for file in (new, earlier):
        refused = "backup", "--data", tmp_path / "other", "-o", file
        assert "another data directory" in called(*refused, status=2, COLUMNS="300")
        called("backup", "--data", data, "-o", file)
    with tarfile.open(earlier, "w") as written:  # as if it were cut off: it is of no use
        written.addfile(tarfile.TarInfo(others[0].name))
    called("backup", "--data", tmp_path / "other", "-o", earlier)


def test_an_empty_variable_of_the_data_directory_is_rejected(tmp_path, monkeypatch) -> None:
    with Store(tmp_path):
        pass
    monkeypatch.chdir(tmp_path)
    shown = called("backup", "-o", tmp_path / "b.tar", status=1, TENSORMAP_DATA_DIR="")
    assert "TENSORMAP_DATA_DIR: it is empty" in shown
    assert not (tmp_path / "b.tar").exists()
