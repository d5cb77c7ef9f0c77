"""The store of a data directory, for commands: which folders they reject, and what they say."""

import pytest

from app.cli.opened_store import opened_store
from app.settings import Settings
from storage.errors import StorageUnavailable
from storage.store import Store
from tests.support.commands import called


@pytest.mark.parametrize(
    "command", [["backup", "-o", "b.tar"], ["verify"], ["audit", "verify"], ["recycle-bin", "list"]]
)
def test_a_folder_whose_catalog_is_elsewhere_is_rejected_with_the_setting(
    tmp_path, command, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    data = tmp_path / "data"
    with Store(data):
        pass
    (data / "catalog.sqlite3").unlink()
    shown = " ".join(called(*command, "--data", data, status=1).split())
    assert f"{data} has no catalog.sqlite3: if its catalog is on PostgreSQL, set" in shown
    assert "TENSORMAP_CATALOG_URL" in shown
    assert not (data / "catalog.sqlite3").exists()


def test_a_folder_that_is_no_data_directory_gets_no_catalog(tmp_path):
    with (
        pytest.raises(StorageUnavailable, match="is no data directory"),
        opened_store(Settings(data_dir=tmp_path)),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
