"""A store with a drive and a revision, and its backup."""

import pytest

from storage.backup.backup import write_backup
from tests.support.backups import add_revision, put


@pytest.fixture
def filled(store):
    put(store, range(5))
    add_revision(store)
    return store


@pytest.fixture
def backup(filled, tmp_path):
    path = tmp_path / "backup.tar"
    write_backup(filled.layout.data_dir, path)
    return path
