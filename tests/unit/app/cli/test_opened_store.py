"""The store of a data directory, for commands: which folders they reject, and what they say."""

import errno
import os
from pathlib import Path

import pytest

from app.cli.opened_store import opened_store, require_catalog
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


def test_a_data_directory_that_may_not_be_looked_into_is_not_said_to_be_none(tmp_path, monkeypatch):
    stat = os.stat

    def refuse(path, *arguments, **options):
        if Path(path).parent == tmp_path:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", refuse)
    monkeypatch.setattr(Path, "exists", os.path.exists)  # as it is from Python 3.14 on
    with pytest.raises(PermissionError):
        require_catalog(tmp_path, None)
