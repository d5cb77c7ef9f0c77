"""Stored files are private to their owner, with any umask and after any command."""

import os
import stat

import pytest

from core.errors import InvalidParameters
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.files.map_file import write_map
from storage.store import Store, permissions
from tests.support.catalog_rows import FACTS
from tests.support.samples import sample_map
from tests.support.small_scans import sample_scan


@pytest.fixture(autouse=True)
def _permissive_umask():
    before = os.umask(0)
    yield
    os.umask(before)


def filled(store):
    store.maps.create("campus")
    store.drives.put_scan("campus", "monday", 0, sample_scan(0))
    tensor_map, _ = sample_map()
    store.revisions.add(
        store.maps.get("campus").id,
        tensor_map.revision,
        lambda path: write_map(path, tensor_map),
        FACTS,
    )


def open_to_others(folder):
    """Return the modes of what others than its owner may use."""
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in (folder, *folder.rglob("*"))}
    return {str(path.relative_to(folder)): oct(m) for path, m in modes.items() if m & 0o077}


def test_files_folders_and_the_catalog_are_private(tmp_path):
    with Store.serving(tmp_path / "data") as store:
        filled(store)
        names = {path.name for path in (tmp_path / "data").iterdir()}
        assert {"catalog.sqlite3", "catalog.sqlite3-wal", "catalog.sqlite3-shm"} <= names
        assert open_to_others(tmp_path / "data") == {}


def test_a_data_directory_of_an_older_version_becomes_private_at_a_start(tmp_path):
    data = tmp_path / "data"
    with Store.serving(data) as store:
        filled(store)
    for path in (data, *data.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    (data / "backup.tar").touch(0o644)  # whose else is there is none of our business
    with Store.serving(data) as store:
        assert open_to_others(data) == {"backup.tar": "0o644"}
        assert store.drives.read_scan("campus", "monday", 0).points_m.size


def test_the_target_of_a_link_is_not_changed(tmp_path):
    data, elsewhere = tmp_path / "data", tmp_path / "elsewhere"
    Store.serving(data).close()
    elsewhere.touch(0o644)
    (data / "orphans").mkdir(0o755)
    (data / "orphans" / "link").symlink_to(elsewhere)
    data.chmod(0o755)
    Store.serving(data).close()
    assert stat.S_IMODE(elsewhere.stat().st_mode) == 0o644
    assert stat.S_IMODE((data / "orphans").stat().st_mode) == 0o700


@pytest.mark.parametrize("linked", ["data", "data/maps"])
def test_the_folder_of_another_disk_that_a_link_names_becomes_private(tmp_path, linked):
    data, elsewhere = tmp_path / "data", tmp_path / "elsewhere"
    with Store.serving(data) as store:
        filled(store)
    (tmp_path / linked).rename(elsewhere)
    (tmp_path / linked).symlink_to(elsewhere)
    elsewhere.chmod(0o755)
    Store.serving(data).close()
    assert open_to_others(elsewhere) == {}


@pytest.fixture
def of_another_user(tmp_path):
    if os.geteuid() != 0:
        pytest.skip("root alone can give files to another user")
    data = tmp_path / "data"
    with Store.serving(data) as store:
        filled(store)
    for path in (data, *data.rglob("*")):
        os.chown(path, 4321, 4321)
    return data


def test_root_does_not_write_files_that_the_owner_of_the_data_could_not_read(of_another_user):
    with pytest.raises(InvalidParameters, match="belongs to user 4321"):
        Store.serving(of_another_user)
    assert {path.stat().st_uid for path in of_another_user.rglob("*")} == {4321}


def test_root_makes_no_data_in_the_folder_of_another_user(tmp_path):
    if os.geteuid() != 0:
        pytest.skip("root alone can give files to another user")
    data = tmp_path / "data"
    data.mkdir()
    os.chown(data, 4321, 4321)
    with pytest.raises(InvalidParameters, match="belongs to user 4321"):
        Store.serving(data)
    assert [path.name for path in data.iterdir() if path.stat().st_uid == 0] == []


def test_root_serves_a_file_system_on_which_all_files_belong_to_one_user(
    of_another_user, monkeypatch
):
    monkeypatch.setattr(permissions, "_owner_of_a_new_file", lambda _folder: 4321)
    with Store.serving(of_another_user) as store:
        assert store.drives.read_scan("campus", "monday", 0).points_m.size


def test_a_restored_data_directory_is_private(tmp_path):
    with Store.serving(tmp_path / "data") as store:
        filled(store)
    write_backup(tmp_path / "data", tmp_path / "backup.tar")
    assert stat.S_IMODE((tmp_path / "backup.tar").stat().st_mode) == 0o600
    restore_backup(tmp_path / "backup.tar", tmp_path / "new")
    assert open_to_others(tmp_path / "new") == {}
