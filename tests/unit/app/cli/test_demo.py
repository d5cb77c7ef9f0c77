"""`tensormap demo`: how it ends where its service fails."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

from tensormap_client.problems import StorageFull

from tests.support.commands import called


@contextmanager
def _no_server(*_: object) -> Iterator[SimpleNamespace]:
    yield SimpleNamespace(url="http://127.0.0.1:9")


def test_a_full_disk_is_named_as_that_of_the_temporary_folder(monkeypatch, tmp_path) -> None:
    def full(*_: object) -> None:
        raise StorageFull("PUT /v1/x: 507 storage-full: raise the quota", 507, "storage-full", "")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("app.demo.server.running_server", _no_server)
    monkeypatch.setattr("app.demo.run.run_demo", full)
    shown = called("demo", "--once", status=1)
    assert f"raise the quota; it is the disk of {tmp_path}/tensormap-demo-" in shown
    assert shown.endswith(": TMPDIR names a folder on another one\n")
    assert not list(tmp_path.iterdir())
